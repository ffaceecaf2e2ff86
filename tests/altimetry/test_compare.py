"""Several methods on one track: counts, what is shared, and what is refused."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from spl_batch import api
from spl_batch.altimetry.compare.comparison import METHODS
from spl_batch.engine.watch.events import TaskEnded
from tests import surveys
from tests.altimetry.tracks import (
    f1,
    labels,
    small_track,
    write_atl03,
    write_atl08,
    write_workflow,
)

CHOSEN = ("likelihood", "published")


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("compared")
    track = {"gt1r": small_track(5)}
    photons = write_atl03(folder / "atl03.h5", track)
    write_atl08(folder / "atl08.h5", photons, track)
    workflow = write_workflow(folder, "atl03.h5", reference={"labels": "atl08.h5"})
    ended = surveys.command("compare", workflow, "--methods", ",".join(CHOSEN), "--workers", 0)
    assert ended.status == 0, ended.text
    assert all(method in ended.text for method in CHOSEN)
    return folder / "out"


def test_counts_are_those_of_the_delivered_tables(compared: Path) -> None:
    methods = json.loads((compared / "compare.json").read_text())["methods"]
    assert [m["name"] for m in methods] == list(CHOSEN)
    kept = [labels(compared / "compare" / method, "atl03/gt1r")["signal"] == 1 for method in CHOSEN]
    truth = small_track(5).truth > 0
    for method, mine in zip(methods, kept, strict=True):
        assert method["signal"] == np.count_nonzero(mine) > 0
        assert method["kept_only"] == np.count_nonzero(mine & ~kept[0])
        assert method["removed_only"] == np.count_nonzero(kept[0] & ~mine)
        assert method["labels"]["f1"] == pytest.approx(f1(mine, truth))
    assert methods[1]["kept_only"] + methods[1]["removed_only"] > 0
    assert [m["false_signal"] is None for m in methods] == [False, True]
    page = (compared / "compare.html").read_text()
    assert page.count("data:image/png") == 1
    assert "<script" not in page


def test_one_method_more_costs_itself_alone(compared: Path) -> None:
    shared = next((compared / "store/photons").rglob("*.parquet"))
    own = compared / "compare/published" / shared.relative_to(compared)
    assert shared.samefile(own)
    seen: list[Any] = []
    workflow = compared.parent / "workflow.yaml"
    again = api.compare(workflow, ["published", "mdbscan"], workers=0, listener=seen.append)
    assert again.exit_status == 0
    kinds = [event.kind for event in seen if isinstance(event, TaskEnded)]
    assert sorted(kinds) == sorted(["label", "profile", "compare", "deliver_beam", "deliver_file"])


@pytest.mark.parametrize("methods", ["mdbscan", "mdbscan,mdbscan", "mdbscan,voxel", ""])
def test_a_wrong_list_names_what_there_is(methods: str, tmp_path: Path) -> None:
    write_atl03(tmp_path / "atl03.h5", {"gt1r": small_track(5)})
    ended = surveys.command("compare", write_workflow(tmp_path, "atl03.h5"), "--methods", methods)
    assert ended.status == 2
    assert METHODS.known in ended.err
    assert len(ended.err.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_a_receiver_of_one_method_reports_it() -> None:
    workflow = Path(__file__).parents[2] / "workflows" / "coincidence.yaml"
    ended = surveys.command("compare", workflow, "--methods", "likelihood,mdbscan")
    assert ended.status == 2
    assert "imaging, altimetry" in ended.err
