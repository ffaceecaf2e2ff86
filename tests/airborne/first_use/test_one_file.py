"""One file without a workflow: the labels of a run, and nothing lost on the way."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio

from spl_batch import api
from spl_batch.airborne.first_use import one_file
from spl_batch.airborne.first_use.clouds import linear_mode_signs, look_at
from spl_batch.airborne.first_use.commented import begin
from spl_batch.airborne.first_use.one_file import KEEP_ALL
from spl_batch.errors import StoppedError, grouped
from tests import surveys

KNOWN = [
    f"--set=acquisition.prf_hz={surveys.PRF_HZ}",
    f"--set=acquisition.gate_m={surveys.GATE_M}",
    "--set=ground.cell_m=50",
    "--set=ground.buffer_m=20",
]


@pytest.fixture(scope="module")
def line(small_lines: Path) -> Path:
    """One short pass without a trajectory."""
    return small_lines.parent / "lines" / "line_1.laz"


def denoise(*arguments: Any) -> surveys.Ended:
    return surveys.command("denoise", *arguments, "--workers", 0, *KNOWN)


def test_labels_and_terrain_are_those_of_a_run(line: Path, tmp_path: Path) -> None:
    cloud, dtm = tmp_path / "clean.laz", tmp_path / "terrain" / "dtm.tif"
    ended = denoise(line, cloud, "--ground", "--dtm", dtm)
    assert ended.status == 0, ended.text
    for guess in (
        f"creates folder {dtm.parent}",
        "channel is called so",
        "WGS 84 / UTM zone 15N",
        "sensor: spl100",
        "beams: ",
    ):
        assert guess in ended.err, guess
    workflow = surveys.write_workflow(tmp_path, survey={"flightlines": str(line)})
    whole = surveys.run(workflow, until="deliver")
    expected = surveys.cloud(whole.output / "laz" / "line_1.laz")
    kept = np.count_nonzero(expected["noise_class"] == 0)
    assert f"signal            {kept:,}".replace(",", " ") in ended.out
    for name, values in surveys.cloud(cloud).items():
        assert values.tobytes() == expected[name].tobytes(), name
    with rasterio.open(dtm) as ours, rasterio.open(whole.output / "dtm.tif") as theirs:
        assert ours.read(1).tobytes() == theirs.read(1).tobytes()
        assert ours.transform == theirs.transform
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "clean.laz",
        "out",
        "terrain",
        "workflow.yaml",
    ]


def test_nothing_is_replaced_unless_told(line: Path, tmp_path: Path) -> None:
    there = tmp_path / "there.laz"
    there.write_bytes(b"somebody's")
    (tmp_path / "work.laz.work").mkdir()
    words = tmp_path / "words.csv"
    words.write_text("a,b\n1,2\n")
    for arguments, said in (
        ((line, there), "is there already; name another file, or add --force"),
        ((line, tmp_path / "new.laz", "--dtm", there), "write a name that ends in .tif\n"),
        ((line, tmp_path / "new.copc.laz"), "ends in .laz, and not in .copc.laz"),
        ((line, line, "--force"), "this is the input"),
        (
            (line, tmp_path / "new.laz", "--trajectory", "no.csv"),
            "--trajectory no.csv: no such file; check the path",
        ),
        (
            (line, tmp_path / "new.laz", "--trajectory", words),
            "rename its columns to gps_time,x,y,z",
        ),
        ((line, tmp_path / "a" / "b" / "new.laz"), f"there is no folder {tmp_path / 'a'}; check"),
        ((line, tmp_path / "work.laz"), "work.laz.work: this folder is needed"),
        ((tmp_path / "w.yaml", tmp_path / "new.laz"), "`spl-batch run` takes a workflow"),
        ((tmp_path / "a.h5", tmp_path / "new.laz"), f"`spl-batch init {tmp_path}` writes"),
        (("s3://bucket/in.laz", tmp_path / "new.laz"), "in.laz: this is a URL"),
    ):
        ended = denoise(*arguments)
        assert ended.status == 2, said
        assert said in ended.err
    assert there.read_bytes() == b"somebody's"
    assert {p.name for p in tmp_path.iterdir()} == {"there.laz", "work.laz.work", "words.csv"}
    assert not Path("s3:").exists()


@pytest.mark.parametrize(
    "override",
    [
        *("units=m", "crs=EPSG:6344", "cell=3", "copc=true", "contour_interval=1", "tiles=laz"),
        *("client_tiles={polygons: a.gpkg}", "geoid={grid: egm.tif}", "catalogue=true"),
    ],
)
def test_files_that_only_a_run_leaves_are_refused(
    line: Path, tmp_path: Path, override: str
) -> None:
    ended = denoise(line, tmp_path / "out.laz", "--set", f"outputs.{override}")
    assert ended.status == 2
    assert f"outputs.{override.partition('=')[0]}: denoise writes one cloud" in ended.text
    assert "spl-batch run" in ended.text
    assert not [*tmp_path.iterdir()]


def test_dropped_points_are_counted(line: Path, tmp_path: Path) -> None:
    ended = denoise(line, tmp_path / "out.laz", "--set", "outputs.drop=[noise]")
    given, kept = (len(surveys.laspy.read(path)) for path in (line, tmp_path / "out.laz"))
    assert kept < given
    said = f"points {grouped(given)} in, {grouped(kept)} out, {grouped(given - kept)} dropped"
    assert said in " ".join(ended.out.split()), ended.out


def test_a_file_without_times_is_told_what_helps(tmp_path: Path) -> None:
    columns = surveys.flightline(shots=20)
    columns["gps_time"] = np.zeros_like(columns["gps_time"])
    source = surveys.write_cloud(tmp_path / "in.laz", columns)
    ended = denoise(source, tmp_path / "out.laz")
    assert ended.status == 2
    assert "no usable gps_time" in ended.err
    assert "filter_points" in ended.err
    assert [p.name for p in tmp_path.iterdir()] == ["in.laz"]


def test_what_stopped_goes_on_and_what_failed_in_part_is_tried_again(
    line: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cloud, work = tmp_path / "out.laz", tmp_path / "out.laz.work"
    ends = iter(["stops", 1, 0])

    def run(*arguments: Any, **options: Any) -> api.RunResult:
        end = next(ends)
        result = api.run(
            *arguments, **{**options, "until": "index" if end == "stops" else "deliver"}
        )
        if end == "stops":
            raise StoppedError("disk full")
        return replace(result, exit_status=end)

    monkeypatch.setattr(one_file, "run", run)
    assert denoise(line, cloud).status == 3
    assert work.is_dir()
    assert not cloud.exists()
    ended = denoise(line, cloud)
    assert ended.status == 1
    assert "the same command tries it again" in ended.out
    assert "index: index file: 0 tasks, 1 finished before" in ended.err
    assert cloud.exists()
    assert denoise(line, cloud).status == 0  # what it wrote itself needs no --force
    assert not work.exists()


def test_linear_mode_lidar_is_refused_unless_the_instrument_is_named(tmp_path: Path) -> None:
    columns = {name: values[::13] for name, values in surveys.flightline().items()}
    source = surveys.write_cloud(tmp_path / "in.laz", columns, channel=False)
    assert linear_mode_signs([look_at(source)]).count(",") == 2, "sparse, and few at the same time"
    ended = denoise(source, tmp_path / "out.laz")
    assert ended.status == 2
    assert [p.name for p in tmp_path.iterdir()] == ["in.laz"]
    _, offered, *_ = " ".join(ended.err.split()).split("`")
    assert offered == f"spl-batch denoise {source} {tmp_path / 'out.laz'} --ground --set {KEEP_ALL}"
    done = denoise(*offered.split()[2:])
    assert done.status == 0
    assert "background noise 0 (0.0 %" in " ".join(done.text.split())
    (tmp_path / "out.laz").unlink()
    assert "guessed: CRS" in done.text
    for sensor in ("als50-ii", "spl100"):
        stated = ("--set", KEEP_ALL, "--set", f"survey.crs={surveys.CRS_NAME}")
        done = denoise(source, tmp_path / "out.laz", "--sensor", sensor, *stated, "--force")
        assert done.status == 0
        assert "guessed: CRS" not in done.text
    (tmp_path / "out.laz").unlink()
    begun = begin(tmp_path)
    assert begun is not None
    assert "filter: {method: none}" in begun.lines
    assert denoise(source, tmp_path / "out.laz", "--sensor", "spl100").status == 0
