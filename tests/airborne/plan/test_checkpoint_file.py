"""A plan reads the file of checkpoints: its faults are told before any work."""

from pathlib import Path

import pytest

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
