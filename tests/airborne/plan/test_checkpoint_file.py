"""A plan reads the file of checkpoints: its faults are told before any work."""

from pathlib import Path

from tests import surveys

HEAD = "id,x,y,z,surface,accuracy_m,crs\n"
EAST, NORTH = surveys.ORIGIN_M


def planned(folder: Path, text: str, **reference: str) -> surveys.Ended:
    (folder / "c.csv").write_text(text)
    surveys.write_cloud(folder / "lines" / "a.laz", surveys.flightline(shots=20))
    reference = {"checkpoints": "c.csv", **reference}
    return surveys.command("plan", surveys.write_workflow(folder, reference=reference))


def test_a_file_without_its_columns_starts_nothing(tmp_path: Path) -> None:
    ended = planned(tmp_path, "name;east;north\nA;1;2\n")
    assert ended.status == 2
    said = " ".join(ended.text.split())
    assert "reference.checkpoints: " in said
    assert "c.csv: lacks the columns id, x, y, z" in said


def test_faults_of_single_checkpoints_are_warnings(tmp_path: Path) -> None:
    ended = planned(
        tmp_path,
        f"{HEAD}A,{EAST + 1},{NORTH},20,open,0.01,\nB,{EAST},{NORTH},x,open,0.01,\n"
        f"C,{EAST},{NORTH},20,open,0.01,EPSG:none\n",
    )
    said = " ".join(ended.text.split())
    assert ended.status == 0
    assert (
        "c.csv: 1 checkpoint is left out, as there is no single point with finite x, y and z: B"
        in said
    )
    assert "c.csv: 1 checkpoint is left out, as the CRS 'EPSG:none' is not known: C" in said
    assert "lies within the survey" not in said


def test_their_crs_is_checked_before_the_work(tmp_path: Path) -> None:
    ended = planned(tmp_path, f"{HEAD}A,1,2,3,open,0.01,\n", checkpoints_crs="UTM")
    assert ended.status == 2
    assert "reference.checkpoints_crs: 'UTM' is not a known CRS" in " ".join(ended.text.split())
