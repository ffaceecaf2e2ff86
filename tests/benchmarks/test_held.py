"""How figures are compared with those that were accepted."""

import json
from pathlib import Path

import pytest

from benchmarks.held import figures
from benchmarks.held.figures import Figure, compare, figure, from_text, to_json, to_text

HASH, OTHER = "c4ed276a0bdca592", "cd7880c1a3463116"


@pytest.mark.parametrize(
    ("worse", "value", "status"),
    [
        ("less", 97.4, "OUTSIDE"),
        ("less", 97.6, "held"),
        ("less", 99.9, "held"),
        ("more", 98.6, "OUTSIDE"),
        ("more", 90.0, "held"),
        ("either", 97.4, "OUTSIDE"),
        ("either", 98.6, "OUTSIDE"),
        ("either", 98.5, "held"),
        ("either", float("nan"), "OUTSIDE"),
    ],
)
def test_a_figure_is_outside_where_it_is_worse_by_more_than_its_tolerance(
    worse: figures.Worse, value: float, status: str
) -> None:
    accepted = {"wires": [figure("kept", 98.0, "%", worse, 0.5)]}
    (row,) = compare({"wires": [figure("kept", value, "%", worse, 0.5)]}, accepted)
    assert (row.status, row.fails) == (status, status == "OUTSIDE")


def test_a_hash_must_be_equal() -> None:
    accepted = {"hashes": [Figure("labels", HASH), Figure("dtm", HASH)]}
    rows = list(compare({"hashes": [Figure("labels", HASH), Figure("dtm", OTHER)]}, accepted))
    assert [row.status for row in rows] == ["held", "OUTSIDE"]


def test_the_tolerance_is_that_of_the_measured_figure() -> None:
    accepted = {"sigma": [figure("within 1", 70.0, "%", "either", 9.0)]}
    (row,) = compare({"sigma": [figure("within 1", 72.0, "%", "either", 1.0)]}, accepted)
    assert row.status == "OUTSIDE"


def test_figures_that_are_gone_fail_and_new_ones_and_other_groups_do_not() -> None:
    accepted = {"a": [figure("one", 1.0)], "b": [figure("two", 2.0)]}
    rows = list(compare({"a": [figure("three", 3.0)]}, accepted))
    assert [(row.figure.name, row.status) for row in rows] == [("three", "new"), ("one", "MISSING")]
    assert [row.fails for row in rows] == [False, True]


def test_the_file_and_the_table_keep_figures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(figures, "ACCEPTED", tmp_path / "held.json")
    a = [figure("kept", 1 / 3, "%", "less", 0.1), figure("none", float("nan"))]
    figures.accept({"a": a})
    figures.accept({"b": [Figure("labels", HASH)]})
    assert figures.accepted() == {"a": a, "b": [Figure("labels", HASH)]}
    assert from_text(to_text(figures.accepted())) == figures.accepted()
    rows = list(compare({"a": a}, figures.accepted()))
    table = json.loads(to_json(rows, {"a": 1.25}))
    assert [one["status"] for one in table["figures"]] == ["held", "held"]
    assert table["figures"][0]["accepted"] == 0.333333
