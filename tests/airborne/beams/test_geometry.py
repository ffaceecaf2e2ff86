"""Beam geometry, heading and PRF."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spl_batch.airborne.beams import geometry
from spl_batch.lattice.tables import COLUMNS, PointTable, Trajectory


def points(**columns: object) -> PointTable:
    length = max(np.size(v) for v in columns.values())
    full = {"scan_angle": 0.0, **columns}
    return PointTable(
        {
            k: np.broadcast_to(np.asarray(v, dtype=COLUMNS[k].dtype), (length,)).copy()
            for k, v in full.items()
        }
    )


@given(st.integers(0, 10_000))
def test_beams_of_shots_are_those_of_their_points(seed: int) -> None:
    rng = np.random.default_rng(seed)
    track = Trajectory(np.arange(8.0), rng.uniform(900.0, 1000.0, (8, 3)), max_gap_s=2.0)
    time = np.sort(rng.choice(rng.uniform(-1.0, 9.0, 6), 40))
    x, y, z = rng.integers(-10_000, 10_000, (3, 40))
    beams = geometry.beams(points(x=x, y=y, z=z, gps_time=time), track)
    origin, known = track.position(time)
    line = np.stack([x, y, z], axis=1) * 0.001 - origin
    range_m = np.linalg.norm(line, axis=1)
    assert beams.known.tolist() == known.tolist()
    np.testing.assert_array_equal(beams.origin_m, origin)
    np.testing.assert_allclose(beams.range_m, range_m, rtol=1e-14)
    np.testing.assert_allclose(beams.direction, line / range_m[:, None], rtol=1e-13)


def test_a_sensor_at_the_point_has_no_beam() -> None:
    track = Trajectory(np.array([0.0, 1.0]), np.zeros((2, 3)))
    beams = geometry.beams(points(x=0, y=0, z=[0, -1000], gps_time=0.5), track)
    assert beams.known.tolist() == [False, True]


def test_a_return_that_no_sensor_there_can_have_seen_has_no_beam() -> None:
    track = Trajectory(np.array([0.0, 1.0]), np.full((2, 3), 1000.0))
    heights_m = np.array([0, 999, 1000, 1001, 100_000, -15_000, -100_000])
    beams = geometry.beams(points(x=0, y=0, z=heights_m * 1000, gps_time=0.5), track)
    assert beams.known.tolist() == [True, False, False, False, False, True, False]


def test_without_trajectory_beams_are_vertical_and_ranges_order_heights() -> None:
    table = points(x=[5, 5], y=[7, 7], z=[1000, 3000], gps_time=[0.0, 0.0], scan_angle=12.0)
    beams = geometry.beams(table, None)
    assert beams.known.all()
    assert beams.direction.tolist() == [[0, 0, -1], [0, 0, -1]]
    assert np.diff(beams.range_m) == pytest.approx(-2.0)


def test_scan_angle_leans_to_starboard_of_the_heading() -> None:
    table = points(x=0, y=0, z=0, gps_time=0.0, scan_angle=30.0)
    north, east = geometry.beams(table, None, heading_rad=0.0), np.pi / 2
    assert north.direction[0] == pytest.approx([0.5, 0, -np.sqrt(0.75)])
    assert geometry.beams(table, None, heading_rad=east).direction[0] == pytest.approx(
        [0, -0.5, -np.sqrt(0.75)], abs=1e-12
    )
    where = north.origin_m + north.direction * north.range_m[:, None]
    assert where == pytest.approx(np.zeros((1, 3)), abs=1e-8)


def test_heading_follows_the_drift_however_it_is_cut() -> None:
    rng = np.random.default_rng(3)
    time = np.sort(rng.uniform(100, 112, 4000))
    angle = rng.uniform(-15, 15, 4000)
    heading = np.deg2rad(-135.0)
    across, along = 800 * np.tan(np.deg2rad(angle)), 70 * time
    x = along * np.sin(heading) + across * np.cos(heading)
    y = along * np.cos(heading) - across * np.sin(heading)
    table = points(x=x * 1000, y=y * 1000, z=0, gps_time=time, scan_angle=angle)
    whole = geometry.observe_track(table)
    found = geometry.heading_from_track(whole)
    assert found is not None
    assert np.angle(np.exp(1j * (found - heading))) == pytest.approx(0, abs=0.05)
    parts = [geometry.observe_track(table.take(slice(k, k + 700))) for k in range(0, 4000, 700)]
    assert geometry.heading_from_track(geometry.merge_track(parts)) == found


def test_three_scan_angles_are_no_geometry() -> None:
    time = np.linspace(0, 20, 999)
    table = points(x=time * 7e4, y=0, z=0, gps_time=time, scan_angle=np.tile([-12, 0, 12], 333))
    assert geometry.heading_from_track(geometry.observe_track(table)) is None
    assert geometry.heading_from_track(geometry.merge_track([])) is None


@pytest.mark.parametrize(("prf", "silent"), [(60_000, 0.4), (20_000, 0.0)])
def test_prf_in_spite_of_silent_shots_and_jitter(prf: float, silent: float) -> None:
    rng = np.random.default_rng(1)
    shot = np.flatnonzero(rng.random(20_000) > silent)
    jitter = np.where(shot % 2, 1.5e-8, -1.5e-8)
    time = np.repeat(2e8 + shot / prf + jitter, 3)
    steps = geometry.shot_steps(np.append(time, np.nan))
    assert geometry.estimate_prf(steps) == pytest.approx(prf, rel=2e-3)


def test_prf_of_rounded_times_is_the_same_however_a_flightline_is_cut() -> None:
    shot = np.sort(np.random.default_rng(2).choice(40_000, 30_000, replace=False))
    time = np.round(3e8 + shot / 25_000, 6)
    half = (time * 1e3).astype(int) % 2 == 0
    for part in (time, time[half], time[~half], time[:300]):
        assert geometry.estimate_prf(geometry.shot_steps(part)) == 25_000


@pytest.mark.parametrize("silent", [0.0, 0.2])
@pytest.mark.parametrize(
    ("prf", "unit_us"),
    [(60_000, 5), (32_000, 10), (24_300, 1)],
)  # fmt: skip
def test_prf_of_times_that_are_rounded(prf: int, unit_us: int, silent: float) -> None:
    rng = np.random.default_rng(3)
    shot = np.flatnonzero(rng.random(60_000) >= silent)
    shot = shot[(shot // 5000) % 3 != 1]  # scans of a turning mirror leave a tile and come back
    time = 371e6 + np.rint(shot / prf * 1e6 / unit_us) * unit_us * 1e-6
    found = geometry.estimate_prf(geometry.shot_steps(np.repeat(time, 2)))
    assert found == pytest.approx(prf, rel=3e-3)
    if silent < 0.2:
        few = geometry.shot_steps(time[:1800])
        assert geometry.estimate_prf(few) == pytest.approx(prf, rel=1e-2)
    both = geometry.shot_steps(time[: len(time) // 2]) + geometry.shot_steps(time[len(time) // 2 :])
    assert geometry.estimate_prf(both) == pytest.approx(prf, rel=3e-3)


def test_returns_of_one_time_and_channel_that_no_beam_explains_are_counted() -> None:
    # A slanted beam, one that is another shot's, another channel, another time.
    table = points(
        x=[0, 2000, 12_000, 0, 0], y=[0, 0, 0, 9000, 0], z=[9000, 0, 0, 0, 0],
        gps_time=[1.0, 1.0, 1.0, 1.0, 2.0], channel=[4, 4, 4, 5, 5],
    )  # fmt: skip
    assert geometry.off_one_beam(table) == (2, 1, 0)
    assert geometry.off_one_beam(table.take(slice(0, 0))) == (0, 0, 0)


@settings(deadline=None)
@given(st.integers(min_value=2, max_value=900))
def test_histograms_of_steps_add_up(cut: int) -> None:
    time = 5.0 + np.cumsum(np.random.default_rng(cut).choice([2e-5, 5e-5], 1000))
    parts = geometry.shot_steps(time[: cut + 1]) + geometry.shot_steps(time[cut:])
    assert np.array_equal(parts, geometry.shot_steps(time))


def test_prf_of_times_that_are_rounded_to_most_of_a_period_has_to_be_stated() -> None:
    shot = np.flatnonzero(np.random.default_rng(4).random(60_000) >= 0.02)
    time = np.rint(shot / 32_000 * 1e6 / 20) * 20 * 1e-6
    assert geometry.estimate_prf(geometry.shot_steps(time)) is None


def test_beam_joins_the_trajectory_with_the_point() -> None:
    track = Trajectory(np.array([0.0, 1.0]), np.array([[0.0, 0, 1000], [100.0, 0, 1000]]))
    table = points(x=[53_000, 0], y=[4_000, 0], z=[0, 0], gps_time=[0.5, 7.0])
    beams = geometry.beams(table, track)
    assert beams.known.tolist() == [True, False]
    assert beams.origin_m[0] == pytest.approx([50, 0, 1000])
    assert beams.range_m[0] == pytest.approx(np.sqrt(9 + 16 + 1e6))
    assert beams.direction[0] * beams.range_m[0] == pytest.approx([3, 4, -1000])
