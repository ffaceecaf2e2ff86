"""What the functions on arrays take, refuse, and say."""

import subprocess
import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import spl_batch
from spl_batch.errors import InputError, WorkflowError

RNG = np.random.default_rng(3)
GROUND = np.c_[RNG.uniform(0, 40, (8_000, 2)), RNG.normal(20, 0.03, 8_000)]
NOISE = RNG.uniform([0, 0, -40], [40, 40, 80], (3_000, 3))
CLOUD = np.vstack([GROUND, NOISE])


def test_a_cloud_alone_is_filtered_and_says_what_its_noise_is_from() -> None:
    labels = spl_batch.filter_points(CLOUD)
    assert labels.basis == "cloud"
    assert labels.warnings == ()
    assert labels.signal[: len(GROUND)].mean() > 0.995
    # 1 % of this noise lies within half a metre of the ground.
    assert labels.signal[len(GROUND) :].mean() < 0.02
    assert np.median(labels.noise_density) == pytest.approx(len(NOISE) / (40 * 40 * 120), rel=0.05)
    assert len(labels) == len(CLOUD)
    assert repr(labels).startswith("Labels(11 000 points: ")
    assert "afterpulses not looked for without gps_time and channel, noise" in repr(labels)
    assert "noise density measured where the cloud is empty)" in repr(labels)


def test_coordinates_that_lost_their_decimals_are_told() -> None:
    far = CLOUD[::10] + np.array([500_000, 5_000_000, 0])
    assert not any("xyz" in text for text in spl_batch.filter_points(far, 0.01).warnings)
    labels = spl_batch.filter_points(far.astype(np.float32), 0.01)
    assert labels.warnings[0].startswith("xyz is float32, which holds 5000040 m to 0.5 m only")
    assert repr(labels).splitlines()[1] == f"warning: {labels.warnings[0]}"
    near = spl_batch.filter_points(CLOUD[::10].astype(np.float32), 0.01)
    assert near.warnings == (), "float32 holds these to the millimetre"
    counts = spl_batch.filter_points(np.rint(far[:100] * 100).astype(np.int32), 0.01)
    assert counts.warnings[0].startswith("xyz holds whole numbers, which are taken as metres")
    cloud = SimpleNamespace(xyz=far)
    with pytest.raises(InputError, match="and no array; give its attribute xyz"):
        spl_batch.filter_points(cloud)  # type: ignore[arg-type]


def test_a_given_density_decides() -> None:
    given = 0.0156
    labels = spl_batch.filter_points(CLOUD, given)
    assert labels.basis == "given"
    assert (labels.noise_density == np.float32(given)).all()
    one_each = spl_batch.filter_points(CLOUD, np.full(len(CLOUD), given))
    np.testing.assert_array_equal(labels.noise_class, one_each.noise_class)
    strict = spl_batch.filter_points(CLOUD, given, alpha=1e-4)
    assert np.count_nonzero(labels.signal & ~strict.signal) > 0


def test_points_far_off_do_not_cost_what_lies_between() -> None:
    far = np.vstack([CLOUD, [[5e8, 5e8, 0.0]]])
    np.testing.assert_array_equal(
        spl_batch.ground_points(far)[: len(CLOUD)], spl_batch.ground_points(CLOUD)
    )
    with pytest.raises(InputError, match="cell_m"):
        spl_batch.rasterize(far)
    with pytest.raises(InputError, match="xyz"):
        spl_batch.filter_points(far)
    with pytest.raises(InputError, match="noise_density"):
        spl_batch.filter_points(CLOUD, 1e5)


def test_a_mask_a_class_and_labels_mean_the_same() -> None:
    labels = spl_batch.filter_points(CLOUD)
    found = [spl_batch.ground_points(CLOUD, x) for x in (labels, labels.noise_class, labels.signal)]
    np.testing.assert_array_equal(found[0], found[1])
    np.testing.assert_array_equal(found[0], found[2])


def test_nothing_gives_nothing() -> None:
    none = np.empty((0, 3))
    assert len(spl_batch.filter_points(none)) == 0
    assert len(spl_batch.filter_points(none, gps_time=[], channel=[])) == 0
    assert len(spl_batch.ground_points(none)) == 0
    with pytest.raises(InputError, match="no point"):
        spl_batch.rasterize(none)


def test_points_without_a_time_or_an_origin_are_not_assessed() -> None:
    time = np.repeat(np.arange(2_750) * 1e-4, 4)
    channel = np.tile(np.arange(4), 2_750)
    time[7] = np.nan
    origin = np.tile([20.0, 20.0, 2_000.0], (len(CLOUD), 1))
    origin[400:404] = np.nan
    shuffled = RNG.permutation(CLOUD)
    labels = spl_batch.filter_points(shuffled, gps_time=time, channel=channel, beam_origin=origin)
    assert np.flatnonzero(labels.noise_class == 255).tolist() == [7, 400, 401, 402, 403]
    assert any("5 of 11 000 points" in text for text in labels.warnings)


def test_expected_noise_elsewhere_needs_beams() -> None:
    found = spl_batch.expected_noise(CLOUD)
    assert found.basis == "cloud"
    with pytest.raises(InputError, match="needs beams"):
        spl_batch.expected_noise(CLOUD, at=[[0.0, 0.0, 0.0]])


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"xyz": np.zeros((5, 2))}, r"shape \(5, 2\)"),
        ({"xyz": [["a", "b", "c"]]}, "give \\(n, 3\\) numbers"),
        ({"xyz": [[0.0, np.nan, 0.0]]}, "1 point not finite, the first is number 0"),
        ({"xyz": [[0.0, 0.0, 2e7]]}, "point number 0 lies at 0, 0, 2e\\+07"),
        ({"noise_density": -1.0}, "-1 .* 0 to 100"),
        ({"noise_density": [0.1, 0.2]}, r"shape \(2,\)"),
        ({"noise_density": [None] * len(CLOUD)}, "nan .* 0 to 100"),
        ({"noise_density": "dense"}, "no numbers; give returns per cubic metre"),
        ({"xyz": CLOUD * [5e-5, 5e-5, 1] + [8.5, 47.3, 0]}, "look like degrees; reproject"),
        ({"gps_time": [0.0, 1.0]}, "gps_time: has shape"),
        ({"gps_time": 0.0}, "11 000 points have the time 0, and no shot has so many"),
        ({"gps_time": np.nan}, "no time is usable; leave it out"),
        ({"channel": np.zeros(len(CLOUD))}, "channel: .* give gps_time"),
        ({"gps_time": 0.0, "channel": np.full(len(CLOUD), 300)}, "300 .* 0 to 255"),
        ({"channel": [0.5], "gps_time": [1.0]}, "gps_time: has shape .*; channel: has"),
        ({"beam_origin": [0.0, 0.0, 1e3]}, "give gps_time"),
        ({"gps_time": np.arange(len(CLOUD)), "beam_origin": [0.0]}, r"shape \(1,\)"),
    ],
)
def test_each_fault_names_the_array_and_the_remedy(arguments: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        spl_batch.filter_points(**{"xyz": CLOUD, **arguments})


def test_each_wrong_setting_is_named() -> None:
    for arguments, said in (
        ({"settings": {"tiling": {}}}, "settings: tiling"),
        ({"settings": {"filter": {"alhpa": 1}}}, "alpha"),
        ({"alpha": 2.0}, "alpha"),
        ({"alpha": 0}, "alpha"),
        ({"method": "best"}, "method"),
        ({"sensor": "spl1"}, "spl100"),
    ):
        with pytest.raises(WorkflowError, match=said):
            spl_batch.filter_points(CLOUD, **arguments)  # type: ignore[arg-type]


def test_noise_that_a_filter_kept_sets_no_top_whatever_says_what_it_kept() -> None:
    rng = np.random.default_rng(3)
    edge_m, per_m2, per_m3 = 70, 20, 0.1
    ground = rng.uniform((0, 0, -0.05), (edge_m, edge_m, 0.05), (per_m2 * edge_m**2, 3))
    noise = rng.uniform((0, 0, -100), (edge_m, edge_m, 100), (int(200 * per_m3 * edge_m**2), 3))
    xyz = np.concatenate([ground, noise]) + np.array([500_000, 5_000_000, 0])
    labels = spl_batch.filter_points(xyz)
    is_ground = np.arange(len(xyz)) < len(ground)
    for given in (labels, labels.noise_class, labels.signal):
        assert np.nanmax(spl_batch.rasterize(xyz, given, is_ground).dsm) < 1.0
    unfiltered = spl_batch.rasterize(xyz[labels.signal], None, is_ground[labels.signal])
    assert np.nanmax(unfiltered.dsm) > 1.0, "nothing shows that there is noise"


def test_rasters_as_xarray() -> None:
    pytest.importorskip("xarray", reason="xarray is not installed")
    made = spl_batch.rasterize(GROUND).to_xarray()
    assert made.dtm.dims == ("y", "x")
    assert float(made.dtm.sel(x=20.5, y=20.5)) == pytest.approx(20.0, abs=0.1)


def test_the_package_itself_loads_nothing() -> None:
    code = (
        "import sys, spl_batch; heavy = {'numpy', 'numba', 'zarr', 'dask', 'rasterio'};"
        "print(sorted(heavy & set(sys.modules)), 'filter_points' in dir(spl_batch))"
    )
    said = subprocess.run(  # noqa: S603 - what stands here
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert said.stdout.split() == ["[]", "True"]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 3])
def test_terrain_of_a_cloud_alone_lies_on_its_ground_at_the_rim_of_slanting_beams(
    seed: int,
) -> None:
    rng = np.random.default_rng(seed)
    edge_m = 150.0
    ground = np.c_[rng.uniform(0, edge_m, (60_000, 2)), rng.normal(40, 0.05, 60_000)]
    noise = rng.uniform([0, 0, -80], [edge_m, edge_m, 160], (100_000, 3))
    noise[:, 0] += 0.3 * (noise[:, 2] - 40)
    followers = rng.choice(noise, 15_000) - rng.uniform(0, 2, (15_000, 1)) * [0.3, 0, 1]
    cloud = np.vstack([ground, noise, followers])
    labels = spl_batch.filter_points(cloud)
    made = spl_batch.rasterize(cloud, labels, spl_batch.ground_points(cloud, labels))
    assert 39 < np.nanmin(made.dtm) < np.nanmax(made.dtm) < 41
