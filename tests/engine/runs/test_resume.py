"""What a later run may trust: a file that no longer fits its receipt is made again."""

import shutil
from pathlib import Path
from typing import Any

import pytest

from spl_batch import api
from spl_batch.airborne.tasks import surfaces
from tests import surveys


@pytest.fixture
def survey(tmp_path: Path) -> Path:
    for psid in (1, 2):
        line = surveys.flightline(shots=60, psid=psid, seed=psid)
        surveys.write_cloud(tmp_path / "lines" / f"{psid}.laz", line)
    return surveys.write_workflow(tmp_path)


def rasters(output: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(output.glob("*.tif"))}


def test_a_task_stopped_half_way_leaves_no_receipt_that_speaks_for_it(
    survey: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    output = api.run(survey, workers=0, until="deliver").output
    first = rasters(output)
    receipts = set((output / "store" / "receipts" / "surface").glob("*.json"))

    write_cell = surfaces.write_cell

    def killed(*args: Any) -> None:
        write_cell(*args)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(surfaces, "write_cell", killed)
        with pytest.raises(KeyboardInterrupt):
            api.run(survey, workers=0, until="deliver", overrides=["products.void_max_m=1"])
    left = set((output / "store" / "receipts" / "surface").glob("*.json"))
    assert len(receipts - left) == 1, "the task that was stopped, and no other"
    (output / "dtm.tif").unlink()
    assert rasters(api.run(survey, workers=0, until="deliver").output) == first


def test_a_plan_counts_what_is_finished_and_writes_nothing(survey: Path) -> None:
    assert api.plan(survey).finished == 0
    surveys.run(survey, until="denoise")
    out = survey.parent / "out"
    before = sorted(out.rglob("*"))
    receipts = [path for path in before if path.parent.parent.name == "receipts"]
    assert api.plan(survey).finished == len(receipts) > 0
    assert sorted(out.rglob("*")) == before


def test_a_plan_warns_of_what_has_no_effect(survey: Path) -> None:
    wanted = ["filter.method=aes", "filter.wires.classify=true"]
    assert len(surveys.found(api.plan(survey, overrides=wanted).findings, "I06")) == 1
    assert not surveys.found(api.plan(survey, overrides=wanted[1:]).findings, "I06")


def test_a_plan_looks_at_the_folder_of_the_output(
    survey: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = shutil.disk_usage(survey.parent)._replace(free=2**16)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
    (note,) = api.plan(survey).findings
    assert (note.code, note.values["kind"], note.values["free"]) == ("E01", "disk", "64 KiB")
