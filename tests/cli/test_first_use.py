"""A first workflow for photons along a track."""

from pathlib import Path

import pytest
import yaml

from spl_batch import api
from spl_batch.errors import WorkflowError
from tests import surveys
from tests.altimetry.tracks import small_track, write_atl03, write_atl08, write_csv


def test_a_granule_and_what_belongs_to_it_are_found(tmp_path: Path) -> None:
    tracks = {"gt1r": small_track(), "gt2l": small_track(2)}
    (tmp_path / "data").mkdir()
    photons = write_atl03(tmp_path / "data" / "a.h5", tracks)
    write_atl08(tmp_path / "labels.h5", photons, tracks)
    write_csv(tmp_path / "ground.csv", tracks["gt1r"])
    (tmp_path / "notes.csv").write_text("a,b\n1,2\n")
    (tmp_path / "broken.h5").write_bytes(b"something")
    ended = surveys.command("init", tmp_path)
    assert ended.status == 0, ended.text
    content = yaml.safe_load((tmp_path / "workflow.yaml").read_text(encoding="utf-8"))
    assert content["kind"] == "altimetry"
    assert content["track"]["photons"] == "data/a.h5"
    assert content["reference"] == {"labels": "labels.h5"}
    for line in ("beams gt1r, gt2l", "left out: ", "broken.h5", "unknown: points: ground.csv"):
        assert line in ended.out.replace("\n  ", " "), line
    assert not api.plan(tmp_path / "workflow.yaml").faults


def test_a_table_is_a_track_where_nothing_else_is(tmp_path: Path) -> None:
    write_csv(tmp_path / "t.csv", small_track())
    begun = api.init(tmp_path)
    content = yaml.safe_load(begun.workflow.read_text(encoding="utf-8"))
    assert content["track"]["photons"] == "t.csv"
    assert "reference" not in content
    assert not begun.unknown


def test_a_folder_without_photons_is_refused_with_what_helps(tmp_path: Path) -> None:
    tracks = {"gt1r": small_track()}
    photons = write_atl03(tmp_path / "a.h5", tracks)
    write_atl08(tmp_path / "b.h5", photons, tracks)
    photons.unlink()
    with pytest.raises(WorkflowError, match=r"b\.h5 is an ATL08 file.* put the ATL03"):
        api.init(tmp_path)
    (tmp_path / "b.h5").write_bytes(b"something")
    with pytest.raises(WorkflowError, match=r"no photon file can be used: .*b\.h5: is no HDF5"):
        api.init(tmp_path)
