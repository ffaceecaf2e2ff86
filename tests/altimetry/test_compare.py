"""Several methods on one track: counts, what is shared, and what is refused."""

import json
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spl_batch import api
from spl_batch.altimetry.compare.comparison import METHODS
from spl_batch.altimetry.filter import peer_filters
from spl_batch.altimetry.report.model import METHOD_NAMES
from spl_batch.engine.watch.events import Note, TaskEnded
from spl_batch.errors import WorkflowError
from tests import surveys
from tests.altimetry.tracks import labels, small_track, write_atl03, write_atl08, write_workflow

CHOSEN = ("bayes", "dbscan", "histogram")


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("sklearn")
    folder = tmp_path_factory.mktemp("compared")
    track = {"gt1r": small_track(5)}
    photons = write_atl03(folder / "atl03.h5", track)
    write_atl08(folder / "atl08.h5", photons, track)
    workflow = write_workflow(folder, "atl03.h5", reference={"labels": "atl08.h5"})
    ended = surveys.command("compare", workflow, "--methods", ",".join(CHOSEN), "--workers", 0)
    assert ended.status == 0, ended.text
    for method in CHOSEN:
        assert method in ended.text
    return folder / "out"


def kept(compared: Path, method: str) -> np.ndarray:
    return labels(compared / "compare" / method, "atl03/gt1r")["signal"] == 1


def test_counts_are_those_of_the_delivered_tables(compared: Path) -> None:
    told = json.loads((compared / "compare.json").read_text())["methods"]
    assert [m["name"] for m in told] == list(CHOSEN)
    first, truth = kept(compared, "bayes"), small_track(5).truth > 0
    for method in told:
        mine = kept(compared, method["name"])
        assert method["signal"] == np.count_nonzero(mine) > 0
        assert method["kept_only"] == np.count_nonzero(mine & ~first)
        assert method["removed_only"] == np.count_nonzero(first & ~mine)
        f1 = 2 * np.count_nonzero(mine & truth) / (mine.sum() + truth.sum())
        assert method["labels"]["f1"] == pytest.approx(f1)
    assert [m["false_signal"] is None for m in told] == [False, True, True]


def test_a_published_filter_is_what_the_library_gives(compared: Path) -> None:
    table = labels(compared / "compare" / "dbscan", "atl03/gt1r")
    found = peer_filters.keep("dbscan", table["along_track"], table["height"])
    np.testing.assert_array_equal(table["signal"] == 1, found)


def test_the_page_shows_every_method_and_where_they_differ(compared: Path) -> None:
    page = (compared / "compare.html").read_text()
    for method in CHOSEN:
        assert METHOD_NAMES[method] in page
    assert "data:image/png" in page
    assert "<script" not in page


def test_one_method_more_costs_itself_alone(compared: Path) -> None:
    assert (compared / "compare/dbscan/store/photons").exists()
    shared = next((compared / "store/photons").rglob("*.parquet"))
    own = compared / "compare/dbscan" / shared.relative_to(compared)
    assert shared.samefile(own)
    seen: list[Any] = []
    workflow = compared.parent / "workflow.yaml"
    again = api.compare(workflow, ["dbscan", "mdbscan"], workers=0, listener=seen.append)
    assert again.exit_status == 0
    kinds = [event.kind for event in seen if isinstance(event, TaskEnded)]
    assert sorted(kinds) == sorted(
        ["rate", "score", "select", "profile", "compare", "deliver_beam", "deliver_file"]
    )


def test_what_only_the_comparison_reads_is_made_again_where_it_is_damaged(compared: Path) -> None:
    """Each run finds all finished; by its size and time nothing has happened to the file."""
    table = next(path for path in (compared / "compare/bayes/photons").rglob("*") if path.is_file())
    content, before = table.read_bytes(), table.stat()
    harmed = bytearray(content)
    harmed[len(content) // 2] ^= 4
    table.write_bytes(harmed)
    os.utime(table, ns=(before.st_atime_ns, before.st_mtime_ns))
    seen: list[Any] = []
    workflow = compared.parent / "workflow.yaml"
    again = api.compare(workflow, ["bayes", "dbscan"], workers=0, listener=seen.append)
    assert again.exit_status == 0
    assert table.read_bytes() == content
    assert [e.text for e in seen if isinstance(e, Note) and str(table) in e.text]


def test_labels_of_a_whole_beam_do_not_depend_on_segments(compared: Path) -> None:
    workflow = compared.parent / "workflow.yaml"
    keys = ["output=cut", "signal.method=histogram", "work.segment_photons=1000"]
    assert api.run(workflow, workers=0, overrides=keys).exit_status == 0
    found = labels(compared.parent / "cut", "atl03/gt1r")["signal"] == 1
    np.testing.assert_array_equal(found, kept(compared, "histogram"))


@pytest.mark.parametrize("methods", ["bayes", "bayes,bayes", "bayes,voxel", "ours,dbscan", ""])
def test_a_wrong_list_names_what_there_is(methods: str, tmp_path: Path) -> None:
    write_atl03(tmp_path / "atl03.h5", {"gt1r": small_track(5)})
    ended = surveys.command("compare", write_workflow(tmp_path, "atl03.h5"), "--methods", methods)
    assert ended.status == 2
    assert ended.err.strip().startswith("spl-batch: --methods: ")
    assert METHODS.known in ended.err
    assert len(ended.err.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_a_missing_library_is_named_before_work_starts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_atl03(tmp_path / "atl03.h5", {"gt1r": small_track(5)})
    workflow = write_workflow(tmp_path, "atl03.h5")
    monkeypatch.setitem(sys.modules, "sklearn", None)
    with pytest.raises(WorkflowError, match=r"spl-batch\[peers\]"):
        api.compare(workflow, "bayes,yapc", workers=0)
    with pytest.raises(WorkflowError, match=r"spl-batch\[peers\]"):
        api.run(workflow, workers=0, overrides=["signal.method=yapc"])
    assert not (tmp_path / "out").exists()


def test_a_receiver_of_one_method_says_so() -> None:
    workflow = Path(__file__).parents[2] / "workflows" / "coincidence.yaml"
    ended = surveys.command("compare", workflow, "--methods", "bayes,dbscan")
    assert ended.status == 2
    assert "kind: coincidence has one method; compare is for imaging, altimetry" in ended.err


@given(st.integers(0, 10_000))
def test_boxes_of_a_histogram_are_counted_by_hand(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 300))
    x, z = rng.uniform(-120.0, 120.0, n), np.round(rng.normal(0.0, 6.0, n), 1)
    found = peer_filters.histogram(x, z)
    boxes: dict[tuple[float, float], int] = {}
    for place in zip(np.floor(x / 50.0), np.floor(z / 2.0), strict=True):
        boxes[place] = boxes.get(place, 0) + 1
    levels = np.arange(np.floor(z / 2.0).min(), np.floor(z / 2.0).max() + 1)
    for i in range(n):
        column = np.floor(x[i] / 50.0)
        counts = np.array([boxes.get((column, level), 0) for level in levels])
        limit = counts.mean() + 3.0 * counts.std()
        assert found[i] == (boxes[column, np.floor(z[i] / 2.0)] > limit)
