"""Whole runs on photon files: labels, profiles, reports, cuts, damage and mistakes."""

import shutil
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow.csv
import pytest
import rasterio
import yaml
from matplotlib.figure import Figure

from spl_batch.altimetry.plan import gather_inputs
from spl_batch.altimetry.report.pictures import TrackAxis
from spl_batch.altimetry.report.summarise import of_labels
from spl_batch.engine.settings.workflow_file import parse_any
from tests import surveys
from tests.altimetry.tracks import (
    f1,
    labels,
    small_track,
    write_atl03,
    write_atl08,
    write_csv,
    write_workflow,
)

ROOT = Path(__file__).parents[2]


def run(workflow: Path, *options: Any) -> Any:
    return surveys.command("run", workflow, "--workers", 0, *options)


def report(workflow: Path) -> Any:
    return surveys.report(workflow.parent / "out")


@pytest.fixture(scope="module")
def granule(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The workflow of a finished run on an ATL03 file with two beams."""
    folder = tmp_path_factory.mktemp("granule")
    tracks = {"gt1r": small_track(1, canopy=0.3), "gt2l": small_track(2)}
    atl03 = write_atl03(folder / "atl03.h5", tracks)
    write_atl08(folder / "atl08.h5", atl03, tracks)
    workflow = write_workflow(
        folder,
        "atl03.h5",
        reference={"labels": "atl08.h5"},
        signal={"window_m": 200},
        work={"segment_photons": 2000},
    )
    ended = run(workflow)
    assert ended.status == 0, ended.text
    return workflow


def test_every_photon_is_delivered_with_a_label(granule: Path) -> None:
    output = granule.parent / "out"
    found = report(granule)
    assert found["counts"]["points_in"] == found["counts"]["points_out"]
    assert found["counts"]["not_assessed"] == 0
    for beam, seed, canopy in (("gt1r", 1, 0.3), ("gt2l", 2, 0.0)):
        track = small_track(seed, canopy=canopy)
        table = labels(output, f"atl03/{beam}")
        np.testing.assert_allclose(table["height"], track.height_m, atol=2e-3)
        assert set(np.unique(table["signal"])) == {0, 1}
        assert f1(table["signal"] == 1, track.truth > 0) > 0.8
        assert ((table["confidence"] >= 0) & (table["confidence"] <= 1)).all()
        sure = table["confidence"][table["signal"] == 1].mean()
        assert sure > table["confidence"][table["signal"] == 0].mean() + 0.5


def test_the_copy_is_the_input_with_labels(granule: Path) -> None:
    output = granule.parent / "out"
    with (
        h5py.File(granule.parent / "atl03.h5") as before,
        h5py.File(output / "hdf5/atl03.h5") as after,
    ):
        names: list[str] = []
        more: list[str] = []
        before.visit(names.append)
        after.visit(more.append)
        added = {
            f"{b}/heights/{n}" for b in ("gt1r", "gt2l") for n in ("spl_signal", "spl_confidence")
        }
        assert set(more) - set(names) == added
        for name in names:
            if isinstance(before[name], h5py.Dataset):
                np.testing.assert_array_equal(before[name][()], after[name][()])
        for beam in ("gt1r", "gt2l"):
            table = labels(output, f"atl03/{beam}")
            for name in ("signal", "confidence"):
                copied = after[f"{beam}/heights/spl_{name}"][()]
                np.testing.assert_array_equal(copied, table[name])


def test_the_profile_follows_the_ground(granule: Path) -> None:
    columns = pyarrow.csv.read_csv(granule.parent / "out/profiles/atl03/gt2l.csv").to_pydict()
    track = small_track(2)
    at = np.array(columns["along_track"]) - 14_000_020.0
    error = np.array(columns["ground"], float) - np.interp(at, *track.reference_m.T)
    assert len(at) >= 29
    assert np.nanmax(np.abs(error)) < 0.5
    assert np.abs(np.array(columns["latitude"]) - 30.0 - at / 111_000.0).max() < 3e-4


def test_agreement_with_atl08_is_reported_beside_mdbscan_s(granule: Path) -> None:
    beams = {beam["name"]: beam for beam in report(granule)["beams"]}
    for beam in beams.values():
        assert set(beam["labels"]) == {"ours", "mdbscan"}
        for found in beam["labels"].values():
            assert found["f1"] > 0.7
            expected = 2 * found["precision"] * found["recall"]
            assert found["f1"] == pytest.approx(expected / (found["precision"] + found["recall"]))
        assert beam["ground"]["n"] > 15, "the heights that ATL08 fits are the reference"
        assert beam["ground"]["rmse"] < 0.5
    assert report(granule)["ground_reference"] == "labels"
    page = (granule.parent / "out/report.html").read_text()
    assert page.count("data:image/png") == 6


def test_results_do_not_depend_on_segments(granule: Path, tmp_path: Path) -> None:
    photons = granule.parent / "atl03.h5"
    workflow = write_workflow(
        tmp_path,
        str(photons),
        reference={"labels": str(granule.parent / "atl08.h5")},
        signal={"window_m": 200},
        work={"segment_photons": 1_000_000},
    )
    assert run(workflow).status == 0
    whole, cut = tmp_path / "out", granule.parent / "out"
    segments = len(list((cut / "store/labels").rglob("*.parquet")))
    assert segments > len(list((whole / "store/labels").rglob("*.parquet")))
    for folder in ("photons", "profiles", "hdf5"):
        for path in (p for p in (whole / folder).rglob("*") if p.is_file()):
            twin = cut / path.relative_to(whole)
            assert path.read_bytes() == twin.read_bytes(), path
    mine, theirs = (report(w)["beams"] for w in (workflow, granule))
    assert [b["labels"] for b in mine] == [b["labels"] for b in theirs]
    assert [b["false_signal"] for b in mine] == [b["false_signal"] for b in theirs]


def test_a_csv_is_labelled_whatever_its_order(tmp_path: Path) -> None:
    track = small_track(3)
    order = np.random.default_rng(0).permutation(len(track.along_m))
    head, *rows = write_csv(tmp_path / "sorted.csv", track).read_text().splitlines()
    (tmp_path / "mixed.csv").write_text("\n".join([head, *(rows[k] for k in order)]) + "\n")
    workflow = write_workflow(tmp_path, "*.csv", work={"segment_photons": 1500})
    assert run(workflow).status == 0
    one, other = (labels(tmp_path / "out", f"{n}/track") for n in ("sorted", "mixed"))
    for name in one:
        np.testing.assert_array_equal(one[name][order], other[name], err_msg=name)
    assert not (tmp_path / "out/hdf5").exists()


@pytest.mark.parametrize(
    ("counts", "kinds"),
    [
        ((30, 9, 25.0), ["clumps"]),
        ((3000, 9, 100.0), []),
        ((3000, 100, 30.0, 9), ["floor"]),
        ((3000, 100, 30.0, 300), []),
        ((30, 0, 0.0), ["all"]),
        ((0, 30, 0.0), ["none"]),
    ],
)
def test_labels_that_are_uncertain_are_named(counts: tuple[Any, ...], kinds: list[str]) -> None:
    assert [one.values["kind"] for one in of_labels(*counts)] == kinds


def test_an_axis_leaves_out_gaps_that_are_longer_than_the_data() -> None:
    at = np.r_[10.0:500.0:20.0, 400_010.0:400_340.0:20.0]
    axis = TrackAxis.of(at)
    shown = axis.km(at)
    assert (np.diff(shown) > 0).all()
    assert np.ptp(shown) == pytest.approx(0.02 * len(at))
    x, y = axis.line(at, at)
    assert np.flatnonzero(np.isnan(x)).tolist() == np.flatnonzero(np.isnan(y)).tolist() == [25]
    axes = Figure().subplots()
    axes.plot(x, y)
    axis.mark(axes)
    label = axes.xaxis.get_major_formatter()
    assert float(label(shown[-1])) == pytest.approx(at[-1] / 1000, abs=0.006)
    assert float(label(shown[3])) == pytest.approx(at[3] / 1000, abs=0.006)
    assert len(TrackAxis.of(at[:25]).gap) == len(TrackAxis.of(at[:1]).gap) == 0


def test_a_simulated_track_is_run_and_measured(tmp_path: Path) -> None:
    scene = tmp_path / "scene.yaml"
    content = yaml.safe_load((ROOT / "workflows/altimetry_scene.yaml").read_text())
    content["track"] |= {"length_m": 1000, "canopy": 0.0}
    scene.write_text(yaml.safe_dump(content))
    ended = surveys.command("simulate", scene, tmp_path / "hills")
    assert ended.status == 0, ended.text
    workflow = tmp_path / "hills/workflow.yaml"
    assert surveys.command("plan", workflow).status == 0
    assert run(workflow).status == 0
    found = report(workflow)
    assert [beam["name"] for beam in found["beams"]] == ["channel006", "channel043"]
    for beam in found["beams"]:
        assert beam["ground"]["rmse"] < 1.5
        assert beam["ground"]["n"] >= 45
        assert beam["baseline_ground"]["n"] >= 40
    sums = [b["ground"]["mean"] * b["ground"]["n"] for b in found["beams"]]
    assert found["ground"]["n"] == sum(b["ground"]["n"] for b in found["beams"])
    assert found["ground"]["mean"] * found["ground"]["n"] == pytest.approx(sum(sums))
    assert found["ground"]["nmad"] < found["ground"]["rmse"]
    with h5py.File(tmp_path / "hills/out/hdf5/track.h5") as file:
        group = file["photon/channel043"]
        assert f1(group["spl_signal"][()] == 1, group["truth"][()] > 0) > 0.9


def test_ground_is_compared_with_a_terrain_raster(tmp_path: Path) -> None:
    track = small_track(3)
    degree = track.along_m / 111_000.0
    rows = zip(track.along_m, track.height_m, degree, strict=True)
    lines = [f"{x:.3f},{z:.3f},{y:.9f},10.0" for x, z, y in rows]
    head = "along_track,height,latitude,longitude"
    (tmp_path / "photons.csv").write_text("\n".join([head, *lines]) + "\n")
    step = 5.0 / 111_000.0
    at = 620.0 - 5.0 * (np.arange(128) + 0.5)
    heights = np.repeat(np.interp(at, *track.reference_m.T)[:, None], 3, axis=1)
    with rasterio.open(
        tmp_path / "dtm.tif", "w", driver="GTiff", height=128, width=3, count=1, dtype="float32",
        crs="EPSG:4326",
        transform=rasterio.Affine(step, 0, 10.0 - 1.5 * step, 0, -step, 620.0 / 111_000.0),
    ) as raster:  # fmt: skip
        raster.write(heights.astype(np.float32), 1)
    reference = {"dtm": "dtm.tif", "remove_bias": True}
    workflow = write_workflow(tmp_path, "photons.csv", reference=reference)
    assert run(workflow).status == 0
    (beam,) = report(workflow)["beams"]
    assert beam["ground"]["median"] == pytest.approx(0.0, abs=1e-12)
    assert beam["ground"]["n"] >= 28
    assert beam["ground"]["rmse"] < 0.3
    with rasterio.open(tmp_path / "dtm.tif", "r+") as raster:
        raster.transform = rasterio.Affine(step, 0, 60.0, 0, -step, 5.0)
    assert run(workflow).status == 0
    (far,) = report(workflow)["findings"]
    assert far["values"]["kind"] == "dtm"
    assert far["values"]["dtm"][0] == pytest.approx(60.0)
    (tmp_path / "dtm.tif").write_text("no raster")
    ended = run(workflow)
    assert ended.status == 1
    assert "dtm.tif" in " ".join(f["reason"] for f in report(workflow)["failures"])


def test_a_reference_without_heights_is_named(granule: Path, tmp_path: Path) -> None:
    write_csv(tmp_path / "photons.csv", small_track(3))
    (tmp_path / "far.csv").write_text("along_track,height\n9000000,1\n9000100,1\n")
    atl08 = granule.parent / "atl08.h5"
    workflow = write_workflow(tmp_path, "photons.csv", reference={"points": "far.csv"})
    assert run(workflow).status == 0
    assert [one["values"]["kind"] for one in report(workflow)["findings"]] == ["points"]
    for name, expected in (
        (tmp_path / "far.csv", ["no hdf5"]),
        (granule.parent / "atl03.h5", ["atl03"]),
        (atl08, ["no atl03"]),
    ):
        workflow = write_workflow(tmp_path, "photons.csv", reference={"labels": str(name)})
        given = parse_any(yaml.safe_load(workflow.read_text()), "given")
        found = gather_inputs(given, tmp_path, tmp_path / "out").warnings
        assert [one.values["kind"] for one in found] == expected
    other = tmp_path / "other.h5"
    shutil.copy(atl08, other)
    with h5py.File(other, "r+") as file:
        for beam in ("gt1r", "gt2l"):
            file[f"{beam}/signal_photons/delta_time"][:] += 86_400.0
    shutil.rmtree(tmp_path / "out")
    atl03 = str(granule.parent / "atl03.h5")
    workflow = write_workflow(tmp_path, atl03, reference={"labels": "other.h5"})
    assert run(workflow).status == 0
    found = [(one["code"], one["values"]["kind"]) for one in report(workflow)["findings"]]
    assert found == [("P01", "granule")]


def test_a_plan_refuses_the_tables_that_a_run_refuses(tmp_path: Path) -> None:
    write_csv(tmp_path / "good.csv", small_track(3))
    (tmp_path / "text.csv").write_text("along_track,height\n1,2\n3,abc\n")
    workflow = write_workflow(tmp_path, "*.csv")
    ended = surveys.command("plan", workflow)
    assert ended.status == 1
    assert "text.csv: column height, line 3: 'abc' is no number" in ended.text
    rows = [f"{x / 1000:.6f},{x % 7}" for x in range(2000)]
    (tmp_path / "text.csv").write_text("\n".join(["along_track,height", *rows]) + "\n")
    workflow = write_workflow(tmp_path, "text.csv")
    for verb in ("plan", "run"):
        ended = surveys.command(verb, workflow)
        assert ended.status == 2
        assert "it is not in metres" in ended.text


def test_a_damaged_beam_is_named_and_the_others_go_on(tmp_path: Path) -> None:
    path = write_atl03(tmp_path / "a.h5", {"gt1r": small_track(1), "gt2l": small_track(2)})
    with h5py.File(path, "r+") as file:
        values = file["gt1r/heights/h_ph"][()]
        del file["gt1r/heights/h_ph"]
        made = file["gt1r/heights"].create_dataset(
            "h_ph", data=values, chunks=(512,), compression="gzip", fletcher32=True
        )
        offset = made.id.get_chunk_info(1).byte_offset
    content = bytearray(path.read_bytes())
    content[offset + 40 : offset + 60] = bytes(20)
    path.write_bytes(content)
    (tmp_path / "b.h5").write_text("no photons")
    workflow = write_workflow(tmp_path, "*.h5")
    ended = run(workflow)
    assert ended.status == 1
    assert "Traceback" not in ended.text
    found = report(workflow)
    assert [beam["name"] for beam in found["beams"]] == ["gt2l"]
    reasons = " ".join(f["reason"] for f in found["failures"])
    assert "damaged HDF5" in reasons
    assert "is no HDF5 file" in reasons


@pytest.mark.parametrize(
    ("sections", "words"),
    [
        ({"track": {"photons": "photons.csv", "beams": ["gt1r"]}}, "it has track"),
        ({"signal": {"window_m": 10}}, "signal.window_m"),
        ({"reference": {"points": "photons.csv", "dtm": "photons.csv"}}, "name one of them"),
        ({}, "no input is usable"),
    ],
)
def test_mistakes_are_reported_in_one_line(
    tmp_path: Path, sections: dict[str, Any], words: str
) -> None:
    (tmp_path / "photons.csv").write_text("along_track,height\n")
    ended = run(write_workflow(tmp_path, "photons.csv", **sections))
    assert ended.status == 2
    assert words in ended.text
    assert "Traceback" not in ended.text


def test_photons_without_a_height_and_beams_without_photons(tmp_path: Path) -> None:
    path = write_atl03(tmp_path / "a.h5", {"gt1r": small_track(1), "gt3r": small_track(2)})
    with h5py.File(path, "r+") as file:
        file["gt1r/heights/h_ph"][100:103] = np.finfo(np.float32).max
        file["gt1r/heights/dist_ph_along"][103] = np.nan
        for name in ("h_ph", "dist_ph_along", "lat_ph", "lon_ph"):
            del file[f"gt3r/heights/{name}"]
            file[f"gt3r/heights/{name}"] = np.empty(0)
        file["gt3r/geolocation/segment_ph_cnt"][:] = 0
    workflow = write_workflow(tmp_path, "a.h5", reference={"baseline": False})
    assert run(workflow).status == 0
    found = report(workflow)
    assert [b["photons"] > 0 for b in found["beams"]] == [True, False]
    assert found["counts"]["not_assessed"] == 4
    assert {"kind": "unplaced", "count": 4} in [one["values"] for one in found["findings"]]
    left_out = labels(tmp_path / "out", "a/gt1r")["signal"] == 255
    assert np.flatnonzero(left_out).tolist() == [100, 101, 102, 103]
    assert len(labels(tmp_path / "out", "a/gt3r")["signal"]) == 0
