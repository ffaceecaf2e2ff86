"""A plan reads the file of checkpoints: its faults are told before any work."""

from pathlib import Path

import pytest

from spl_batch import api
from tests import surveys

HEAD = "id,x,y,z,surface,accuracy_m,crs\n"
EAST, NORTH = surveys.ORIGIN_M


ROWS = f"A,{EAST + 1},{NORTH},20,open,0.01,\nB,{EAST},{NORTH},x,open,0.01,\n"
LEFT_OUT = "c.csv: 1 checkpoint is left out, as "


@pytest.mark.parametrize(
    ("text", "reference", "status", "words"),
    [
        ("name;east\nA;1\n", {}, 2, ["reference.checkpoints: ", "lacks the columns id, x, y, z"]),
        (f"{HEAD}A,1,2,3,open,0.01,\n", {"checkpoints_crs": "UTM"}, 2,
         ["reference.checkpoints_crs: 'UTM' is not a known CRS"]),
        (f"{HEAD}{ROWS}C,{EAST},{NORTH},20,open,0.01,EPSG:none\n", {}, 0,
         [f"{LEFT_OUT}there is no single point with finite x, y and z: B",
          f"{LEFT_OUT}the CRS 'EPSG:none' is not known: C"]),
    ],
)  # fmt: skip
def test_faults_of_the_file_stop_a_plan_and_those_of_single_checkpoints_warn(
    tmp_path: Path, text: str, reference: dict[str, str], status: int, words: list[str]
) -> None:
    (tmp_path / "c.csv").write_text(text)
    surveys.write_cloud(tmp_path / "lines" / "a.laz", surveys.flightline(shots=20))
    reference = {"checkpoints": "c.csv", **reference}
    ended = surveys.command("plan", surveys.write_workflow(tmp_path, reference=reference))
    said = " ".join(ended.text.split())
    assert ended.status == status
    assert [word for word in words if word not in said] == []
    assert "lies within the survey" not in said


US_M, FEET, METRES = 1200 / 3937, "EPSG:2278+6360", "EPSG:32140+5703"


@pytest.mark.parametrize(
    ("z", "crs", "said"),
    [
        (20 / US_M, "", ""),
        (20 / US_M, FEET, ""),
        (20, "EPSG:2278+5703", "heights from metres to US survey feet"),
        (20, "", "none of 1 checkpoints has a height that points have there: 20.00 ft (6.10 m)"),
        (20, FEET, "name it, reference.checkpoints_crs: EPSG:...+5703 (EPSG:6360 states US survey"),
        (20, "EPSG:32140", "the survey's heights are in US survey feet: name it in reference."),
    ],
)
def test_metres_beside_a_survey_in_feet_are_named(
    tmp_path: Path, z: float, crs: str, said: str
) -> None:
    path = surveys.write_cloud(tmp_path / "a.laz", surveys.flightline(shots=20, noise=0.0))
    surveys.in_feet(path, tmp_path / "lines" / "a.laz", FEET, [US_M] * 3)
    text = f"{HEAD}A,{(EAST + 1) / US_M},{NORTH / US_M},{z},open,0.01,{crs}\n"
    (tmp_path / "c.csv").write_text(text)
    workflow = surveys.write_workflow(tmp_path, reference={"checkpoints": "c.csv"})
    ended = surveys.command("plan", workflow)
    text = " ".join(ended.text.split())
    assert said in text
    unit = "metres" if crs == "EPSG:2278+5703" else "US survey feet"
    assert (f"checkpoints c.csv: heights in {unit} " in f"{text} ") == (ended.status == 0)
    assert ended.status == (2 if crs == "EPSG:32140" else 0)
    assert ("C01" in ended.text) == bool(said and ended.status == 0)


def test_far_noise_in_the_headers_box_makes_no_good_checkpoint_a_bad_one(tmp_path: Path) -> None:
    line = surveys.flightline(shots=20, noise=0.0)
    line["z"][:2] = -9_000.0, 9_000.0
    surveys.write_cloud(tmp_path / "lines" / "a.laz", line)
    (tmp_path / "c.csv").write_text(f"{HEAD}A,{EAST + 0.5},{NORTH},20.02,open,0.01,\n")
    workflow = surveys.write_workflow(tmp_path, reference={"checkpoints": "c.csv"})
    assert not surveys.found(api.plan(workflow).findings, "C01")


def test_every_unit_of_a_file_is_named(tmp_path: Path) -> None:
    surveys.write_cloud(tmp_path / "lines" / "a.laz", surveys.flightline(shots=20), crs=METRES)
    places = [f"A,{EAST + 1},{NORTH},20,open,0.01,\n", f"B,{EAST},{NORTH},20,vva,0.01,{METRES}\n"]
    foot = f"C,{(EAST + 1) / US_M},{NORTH / US_M},{20 / US_M},open,0.01,{FEET}\n"
    workflow = surveys.write_workflow(tmp_path, reference={"checkpoints": "c.csv"})
    for rows, said in ((places, "metres"), ([*places, foot], "metres and US survey feet")):
        (tmp_path / "c.csv").write_text(HEAD + "".join(rows))
        text = " ".join(surveys.command("plan", workflow).text.split())
        assert f"checkpoints c.csv: heights in {said} " in f"{text} "


def test_places_are_in_the_units_of_the_survey(tmp_path: Path) -> None:
    path = surveys.write_cloud(tmp_path / "a.laz", surveys.flightline(shots=20))
    surveys.in_feet(path, tmp_path / "lines" / "a.laz", FEET, [US_M] * 3)
    (tmp_path / "c.csv").write_text(f"{HEAD}A,1000,2000,66,open,0.01,\n")
    workflow = surveys.write_workflow(tmp_path, reference={"checkpoints": "c.csv"})
    said = " ".join(surveys.command("plan", workflow).text.split())
    assert "they lie within 1 000 to 1 000 ft E, 2 000 to 2 000 ft N (305 to 305 m E" in said
    assert "its points within 892 " in said
