"""Which times of a file are those of flightlines, and which are none."""

from typing import Any

import numpy as np
import pytest

from spl_batch.airborne.plan.flightlines import find_flightlines, is_timeless
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.airborne.tasks.file_tally import SPANS_FEW, facts_of, merge, observe, spans_of
from spl_batch.airborne.tasks.index import _without_time
from spl_batch.engine.tasks.task import Receipt
from spl_batch.formats.las.reader import iter_points
from spl_batch.lattice.tables import PointTable
from tests import surveys

APART_S = 3600.0
"""Between the spans of these files [s]."""

GAP_S = 60.0
"""A pause that ends a span [s]."""

WORKFLOW = Workflow.model_validate({"survey": {"flightlines": ["a.laz"]}, "output": "out"})


@pytest.fixture(scope="module")
def points(tmp_path_factory: pytest.TempPathFactory) -> PointTable:
    """Points of a file."""
    path = tmp_path_factory.mktemp("tally") / "a.las"
    surveys.write_cloud(path, surveys.flightline(shots=1400, psid=3))
    (table,) = iter_points(path, channel_dimension=None, source=1)
    return table


def indexed(points: PointTable, sizes: list[int]) -> Receipt:
    """Receipt of a file with a span of time of each size, in points."""
    assert len(points) >= sum(sizes)
    table = points.take(slice(0, sum(sizes)))
    apart_s = APART_S * np.repeat(np.arange(len(sizes)), sizes)
    counted = observe(table.with_columns(gps_time=table["gps_time"] + apart_s), GAP_S)
    facts = {"name": "a.laz", **facts_of(merge([counted]), GAP_S)}
    return Receipt("index_file", "1", "", "", "", {}, facts, sum(sizes), 0.0, 0.0)


def flown(receipt: Receipt) -> int:
    return len(find_flightlines({"1": receipt}, WORKFLOW))


def told(receipt: Receipt) -> Any:
    return [str(remark) for remark in _without_time(receipt.facts)]


@pytest.mark.parametrize("unset", [20, 200])
def test_points_at_time_zero_have_none(points: PointTable, unset: int) -> None:
    time = points["gps_time"].copy()
    time[:unset] = 0.0
    counted = observe(points.with_columns(gps_time=time), GAP_S)
    facts = {"name": "a.laz", **facts_of(counted, GAP_S)}
    receipt = Receipt("index_file", "1", "", "", "", {}, facts, len(points), 0.0, 0.0)
    assert flown(receipt) == 1
    assert facts["timeless"] == unset
    assert facts["spans"]["3"][0][0] == time[unset] > 0
    assert len(told(receipt)) == 1


def test_scattered_times_are_no_flightlines(points: PointTable) -> None:
    """Each of them would cost a run some tasks: a small file would stop a survey."""
    receipt = indexed(points, [1] * 1500)
    assert flown(receipt) == 0
    assert is_timeless(receipt, WORKFLOW)
    assert receipt.facts["timeless"] == 1500


@pytest.mark.parametrize("size", [1, 9, 19])
def test_among_scattered_times_flightlines_stay(points: PointTable, size: int) -> None:
    receipt = indexed(points, [1500, *[size] * 200, 700])
    assert flown(receipt) == 2
    assert receipt.facts["timeless"] == 200 * size
    (found,) = _without_time(receipt.facts)
    assert found.code == "I02"
    assert found.values["count"] == 200 * size


@pytest.mark.parametrize("among", [0, 5000])
def test_scattered_times_are_not_kept(points: PointTable, among: int) -> None:
    """A file may have as many of them as points, for every point source id."""
    receipt = indexed(points, [1] * 2000 + [among] * bool(among))
    assert flown(receipt) == bool(among)
    assert receipt.facts["timeless"] == 2000
    table = points.take(slice(0, 1500 + among))
    table = table.with_columns(
        point_source_id=np.minimum(np.arange(len(table), dtype=np.uint16), 1500)
    )
    counted = observe(table, GAP_S)
    facts = facts_of(counted, GAP_S)
    assert facts["timeless"] == 1500
    assert len(facts["spans"]) == len(spans_of(counted)) == bool(among)
    assert sum(array.nbytes for array in counted.values()) < 100_000


@pytest.mark.parametrize("sizes", [[150] * 150, [1] * SPANS_FEW, [500] * 30 + [4] * 70])
def test_many_short_spans_are_flightlines(points: PointTable, sizes: list[int]) -> None:
    """As in a tile, where many flightlines end or are cut at a corner."""
    receipt = indexed(points, sizes)
    assert flown(receipt) == len(sizes)
    assert not receipt.facts["timeless"]
    assert not told(receipt)
