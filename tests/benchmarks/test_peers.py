"""What is asked of PDAL beside the chain, and what is made of its answer."""

import json
import shutil
import sys
from pathlib import Path

import laspy
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from numpy.typing import NDArray

from benchmarks.airborne import peers
from benchmarks.airborne.filter.methods import AFTERPULSE, BACKGROUND, GROUND

SURFACE, NOISE = 400, 25

FAKE = """#!{python}
import json, sys
from pathlib import Path
import laspy
if sys.argv[1] == "--version":
    print("-----\\npdal 9.8.7 (git-version: 654321)\\n-----")
    sys.exit()
sum(i * i for i in range(300_000))  # time that can be measured
stages = json.loads(Path(sys.argv[-1]).read_text())["pipeline"]
with open({log!r}, "a") as log:
    log.write(json.dumps(stages) + "\\n")
read = [laspy.read(stage["filename"]) for stage in stages if stage["type"] == "readers.las"]
with laspy.open(stages[-1]["filename"], mode="w", header=read[0].header) as file:
    for las in read:
        las.classification[:] = 1
        if any(stage["type"] == "filters.outlier" for stage in stages):
            las.classification[las.z > 30.0] = 7
        file.write_points(las.points)
"""


@pytest.fixture
def output(tmp_path: Path) -> Path:
    """A run of two files: flat ground, and points far above it; all are called noise already."""
    (tmp_path / "truth").mkdir()
    for number in (2, 1):
        rng = np.random.default_rng(number)
        header = laspy.LasHeader(version="1.4", point_format=6)
        header.scales, header.offsets = np.full(3, 0.001), np.array([5e5, 4e6, 0.0])
        header.add_extra_dim(laspy.ExtraBytesParams("noise_class", "uint8"))
        points = laspy.ScaleAwarePointRecord.zeros(SURFACE + NOISE, header=header)
        above = rng.permutation(SURFACE + NOISE) < NOISE
        row, column = np.divmod(np.arange(SURFACE), 20)
        columns = {name: np.empty(len(above)) for name in "xyz"}
        columns["x"][~above], columns["x"][above] = 5e5 + 0.5 * column, 5e5 + 5.0
        columns["y"][~above], columns["y"][above] = 4e6 + 0.5 * row, 4e6 + 5.0 * number
        columns["z"][~above], columns["z"][above] = 10.0, 50.0 + 9.0 * np.arange(NOISE)
        ones = np.ones(len(above), dtype=np.uint8)
        columns |= {"return_number": ones, "number_of_returns": ones, "classification": 7 * ones}
        for name, values in columns.items():
            points[name] = values
        path = tmp_path / "out" / "laz" / "lines" / f"line_{number}.laz"
        path.parent.mkdir(parents=True, exist_ok=True)
        with laspy.open(path, mode="w", header=header) as file:
            file.write_points(points)
        kinds = np.where(above, rng.choice([BACKGROUND, AFTERPULSE], len(above)), GROUND)
        table = pa.table({"kind": kinds.astype(np.uint8)})
        pq.write_table(table, tmp_path / "truth" / f"line_{number}.parquet")
    return tmp_path / "out"


@pytest.fixture
def asked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Puts a program in PDAL's place; the file into which it writes what it was asked."""
    program, log = tmp_path / "bin" / "pdal", tmp_path / "asked.jsonl"
    program.parent.mkdir()
    program.write_text(FAKE.format(python=sys.executable, log=str(log)), encoding="utf-8")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(program.parent))
    return log


def clouds(output: Path) -> list[Path]:
    return sorted((output / "laz").rglob("*.laz"))


def noise_of(output: Path) -> NDArray[np.bool_]:
    return np.concatenate([np.asarray(laspy.read(cloud).z) > 30.0 for cloud in clouds(output)])


def test_every_file_is_read_as_one_cloud_that_has_forgotten_its_classes(
    output: Path, asked: Path
) -> None:
    answers = list(peers.pdal(clouds(output)))
    assert [name for name, _, _ in answers] == list(peers.PIPELINES)
    assert all(rate > 0.0 for _, rate, _ in answers)
    for line, filters in zip(
        asked.read_text(encoding="utf-8").splitlines(), peers.PIPELINES.values(), strict=True
    ):
        stages = json.loads(line)
        readers = [stage for stage in stages if stage["type"] == "readers.las"]
        assert [Path(stage["filename"]) for stage in readers] == clouds(output)
        assert [stage["type"] for stage in stages[2:4]] == ["filters.merge", "filters.assign"]
        assert stages[4:-1] == filters
        assert Path(stages[-1]["filename"]).suffix == ".laz"


@pytest.mark.usefixtures("asked")
def test_noise_is_compared_point_by_point_with_the_truth(
    output: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert np.array_equal(
        peers.true_noise(clouds(output), output.parent / "truth"), noise_of(output)
    )
    monkeypatch.setattr(peers, "searches", lambda _: [])
    monkeypatch.setattr(peers, "plain_filter", lambda _: ("plain", 2.0))
    peers.print_ratios(output, {"denoise": 3.0})
    lines = capsys.readouterr().out.splitlines()
    assert lines[1].split() == ["plain", "2.00", "1.50"]
    at = lines.index("pdal 9.8.7 (git-version: 654321)")
    assert [line.split()[-2:] for line in lines[at + 2 :]] == [
        ["100.0", "100.00"],  # as the files say that all of it is noise
        ["100.0", "0.00"],
        ["100.0", "0.00"],
    ]


def test_shares_are_of_noise_and_of_signal() -> None:
    noise = np.repeat([True, False], [4, 10])
    classes = np.full(14, 1, dtype=np.uint8)
    classes[[0, 1, 4]] = [7, 18, 18]
    assert peers.called_noise(classes, noise) == pytest.approx((50.0, 10.0))


def test_without_pdal_nothing_is_asked(
    output: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    assert list(peers.pdal(clouds(output))) == []
    assert peers.version() == "pdal is not on the PATH"


@pytest.mark.skipif(shutil.which("pdal") is None, reason="there is no pdal here")
def test_pdal_itself_takes_what_it_is_asked(output: Path) -> None:
    found = {name: classes for name, _, classes in peers.pdal(clouds(output))}
    assert peers.version().startswith("pdal ")
    noise = noise_of(output)
    assert np.unique(found["PDAL, reads and writes"]).tolist() == [1]
    assert np.array_equal(found["PDAL, outliers by radius"] == 7, noise)
    assert (found["PDAL, the same and ground"] == 2).sum() == SURFACE * 2
