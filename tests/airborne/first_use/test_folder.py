"""A first workflow for a folder: what files tell is written, what they do not is said."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from spl_batch import api
from spl_batch.airborne.settings.workflow import load_workflow
from spl_batch.errors import WorkflowError
from spl_batch.formats.las.writer import write_classified
from tests import surveys


def begun(place: Path, **options: Any) -> tuple[api.Beginning, dict[str, Any]]:
    """The verb's result, and the workflow as a run reads it."""
    found = api.init(place, **options)
    load_workflow(found.workflow)
    return found, yaml.safe_load(found.workflow.read_text(encoding="utf-8"))


def test_a_simulated_survey_is_found_whole(tiny_survey: Path, tmp_path: Path) -> None:
    shutil.copytree(tiny_survey.parent, tmp_path / "t", ignore=shutil.ignore_patterns("out"))
    survey = tmp_path / "t"
    given = yaml.safe_load((survey / "workflow.yaml").read_text(encoding="utf-8"))
    found, content = begun(survey, force=True)
    for key in ("flightlines", "trajectory", "channel_dimension"):
        assert content["survey"][key] == given["survey"][key], key
    assert content["reference"]["points"] == given["reference"]["points"]
    told = dict(found.found)
    assert "86 123 points" in told["flightlines"]
    assert "trajectory.sbet may hold the same" in told["trajectory"]
    assert "UTM zone 15N" in told["CRS"]
    assert dict(found.unknown).keys() == {"sensor"}
    text = found.workflow.read_text(encoding="utf-8")
    assert text.count("# ? ") == 1
    assert max(map(len, text.splitlines())) <= 120


def test_the_command_plans_what_it_wrote(small: Path) -> None:
    small.unlink()
    ended = surveys.command("init", small.parent)
    assert ended.status == 0, ended.text
    assert "unknown: trajectory: " in ended.out
    assert "stretches" in ended.out
    assert small.exists()
    ended = surveys.command("init", small.parent)
    assert ended.status == 2
    assert "workflow.yaml is there already" in ended.err
    assert surveys.command("init", small.parent, "--force").status == 0


def test_files_of_other_kinds_are_told_apart(tmp_path: Path) -> None:
    line = surveys.flightline(shots=100)
    surveys.write_cloud(tmp_path / "raw [1]" / "a.laz", line)
    surveys.write_cloud(tmp_path / "raw [1]" / "b.laz", line)
    bare = {k: v for k, v in line.items() if k != "channel"}
    surveys.write_cloud(tmp_path / "old.las", bare, channel=False)
    ground = {**bare, "classification": np.full(len(line["x"]), 2, np.uint8)}
    surveys.write_cloud(tmp_path / "lidar" / "c.laz", ground, channel=False)
    surveys.write_trajectory(tmp_path / "flight.csv")
    (tmp_path / "marks.csv").write_text("id,x,y,z,surface\n1,2,3,4,open\n")
    (tmp_path / "notes.csv").write_text("a,b\n1,2\n")
    (tmp_path / "poscal.out").write_bytes(b"a log of another program")
    (tmp_path / "broken.laz").write_bytes(b"LASF")
    (tmp_path / ".hidden.laz").write_bytes(b"")
    surveys.write_cloud(tmp_path / "earlier" / "laz" / "a.laz", line)
    (tmp_path / "earlier" / "delivered.json").write_text("{}")
    found, content = begun(tmp_path)
    assert content["survey"]["flightlines"] == "raw [1]/*.laz"
    assert api.plan(found.workflow).files == 2
    assert content["survey"]["trajectory"] == "flight.csv"
    assert content["reference"] == {"points": "lidar/c.laz", "checkpoints": "marks.csv"}
    left = found.left_out
    assert any("broken.laz" in text for text in left)
    assert any(text.startswith("old.las: ") for text in left)


def test_a_delivered_cloud_is_no_flightline(tmp_path: Path) -> None:
    line = surveys.flightline(shots=100)
    raw = surveys.write_cloud(tmp_path / "a.laz", line)

    def labels(start: int, stop: int) -> dict[str, Any]:
        return dict.fromkeys(("classification", "noise_class"), np.ones(stop - start, np.uint8))

    write_classified(raw, tmp_path / "b.laz", labels=labels, diagnostics=False, crs=None)
    found, content = begun(tmp_path)
    assert content["survey"]["flightlines"] == "a.laz"
    assert "b.laz: delivered by a run" in found.left_out
    raw.unlink()
    with pytest.raises(WorkflowError, match=r"run delivered alone, such as b\.laz"):
        api.init(tmp_path, force=True)


def test_without_times_only_ground_and_surfaces_are_proposed(tmp_path: Path) -> None:
    line = surveys.flightline(shots=50)
    line["gps_time"] = np.zeros_like(line["gps_time"])
    surveys.write_cloud(tmp_path / "2023.laz", line, channel=False)
    found, content = begun(tmp_path)
    assert "gps_time" in dict(found.unknown)
    assert content["filter"] == {"method": "none"}
    assert content["afterpulse"] == {"enabled": False}
    assert not api.plan(tmp_path / "workflow.yaml").faults


def test_of_linear_mode_lidar_nothing_is_asked_that_no_step_reads(tmp_path: Path) -> None:
    line = {name: values[::13] for name, values in surveys.flightline().items()}
    surveys.write_cloud(tmp_path / "a.laz", line, channel=False)
    ended = surveys.command("init", tmp_path)
    assert ended.out.count("unknown: ") == 1
    assert "unknown: filter: no beamlet numbers, " in ended.out
    assert "beamlets" not in ended.out.replace("beamlet numbers", "")
    content = yaml.safe_load((tmp_path / "workflow.yaml").read_text(encoding="utf-8"))
    assert content["survey"].keys() == {"name", "flightlines"}


def test_a_geocentric_crs_record_is_no_crs_of_a_survey(tmp_path: Path) -> None:
    line = surveys.flightline(shots=50)
    surveys.write_cloud(tmp_path / "a.laz", line, crs="EPSG:4978")
    found, _ = begun(tmp_path)
    assert "geocentric" in dict(found.unknown)["crs"]
    assert "# crs: " in found.workflow.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("", "no LAS, LAZ or COPC file"),
        ("t.h5", "no photon file can"),
        ("t.laz", "no cloud can be"),
    ],
)
def test_a_folder_without_a_survey_is_refused(tmp_path: Path, name: str, said: str) -> None:
    if name:
        (tmp_path / name).write_bytes(b"something")
    with pytest.raises(WorkflowError, match=said):
        api.init(tmp_path)
    if name:
        with pytest.raises(
            WorkflowError, match=r"is (a file; name the folder that holds it|one file: )"
        ):
            api.init(tmp_path / name)
    with pytest.raises(WorkflowError, match="no such folder"):
        api.init(tmp_path / "nowhere")
    assert not (tmp_path / "workflow.yaml").exists()
