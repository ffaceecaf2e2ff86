"""What PROJ lacks is named by commands that fetch it."""

import re
import shlex
from types import SimpleNamespace

import pytest
from pyproj import CRS
from pyproj.__main__ import parser

from spl_batch.formats import transformations
from spl_batch.formats.transformations import lacks


def fetched(text: str) -> list[str]:
    """Files that the command in a message fetches, as pyproj reads each line of it."""
    (command,) = re.findall("`(.*?)`", text)
    lines = [shlex.split(line) for line in command.split(" && ")]
    assert all(line[0] == "pyproj" for line in lines)
    return [parser.parse_args(line[1:]).file for line in lines]


def first_operation(source: str, target: str) -> SimpleNamespace:
    group = transformations._group(CRS(source), CRS(target))
    return group.unavailable_operations[0]


@pytest.mark.parametrize(
    ("source", "target", "count"),
    [("EPSG:27700", "EPSG:25830", 1), ("EPSG:26915", "EPSG:6344", 4)],
)
def test_each_grid_that_is_missing_is_fetched(source: str, target: str, count: int) -> None:
    grids = [grid.short_name for grid in first_operation(source, target).grids]
    assert len(grids) == count
    assert fetched(lacks(CRS(source), CRS(target))) == grids


def test_a_grid_that_is_there_is_not_fetched(monkeypatch: pytest.MonkeyPatch) -> None:
    grids = [
        SimpleNamespace(short_name=name, available=there)
        for name, there in (("a.tif", False), ("b.tif", True), ("c.tif", False))
    ]
    best = SimpleNamespace(grids=grids)
    group = SimpleNamespace(best_available=False, unavailable_operations=[best])
    monkeypatch.setattr(transformations, "_group", lambda *_: group)
    assert fetched(lacks.__wrapped__(CRS(27700), CRS(25830))) == ["a.tif", "c.tif"]
    for grid in grids:
        grid.available = True
    assert lacks.__wrapped__(CRS(27700), CRS(25830)) == "knows none"
