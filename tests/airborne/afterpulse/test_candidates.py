"""Afterpulse evidence, shot by shot."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from spl_batch.airborne.afterpulse import afterpulse_law, candidates
from spl_batch.airborne.afterpulse.shot_evidence import TOGETHER
from spl_batch.airborne.beams import geometry
from spl_batch.airborne.beams.shot_runs import run_starts
from spl_batch.airborne.sensors.sensor import load_preset
from spl_batch.airborne.settings import AfterpulseSettings
from spl_batch.lattice.tables import COLUMNS, PointTable, Trajectory
from spl_batch.numerics.planes.robust_plane import percentile_68_below, spread

SETTINGS = AfterpulseSettings()
SENSOR = load_preset("spl100")
Height = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]


@pytest.mark.parametrize(("plane", "percentile"), [([0, 0, 0], 0.68), ([0, 1, 0], 0.68 / 2**0.5)])
def test_percentile_is_perpendicular(plane: list[float], percentile: float) -> None:
    distance = np.linspace(0, 1, 101) * np.resize([1, -1], 101)
    at = np.array(plane, dtype=np.float64)
    assert percentile_68_below(at, distance, percentile + 1e-6)
    assert not percentile_68_below(at, distance, percentile - 1e-6)


@settings(deadline=None)
@given(
    st.lists(st.floats(0.0, 2.0) | st.sampled_from([0.25, 0.5]), min_size=1, max_size=90),
    st.floats(0.0, 1.0),
)
def test_spread_is_that_of_the_median(values: list[float], least: float) -> None:
    expected = max(float(np.median(values)) / 0.6745, least)
    assert spread(np.array(values), least) == expected


def shots(
    height: Height,
    *,
    number: int = 40,
    detection: float = 0.5,
    afterpulses: float = 0.15,
    second: Height | None = None,
    noise_per_m: float = 1e-3,
    channels: bool = True,
    seed: int = 0,
) -> tuple[PointTable, Trajectory, NDArray[np.int64]]:
    """Shots 14 degrees off nadir over a height field; kind 0 signal, 1 its afterpulse,
    2 background, 3 its afterpulse.

    ``second`` is a surface behind the first, hit by other beamlets a third of the time.
    """
    rng = np.random.default_rng(seed)
    origin = np.array([0.0, -620.0, 2500.0])
    rows = []
    for shot in range(number):
        for channel in range(100):
            x = 0.35 * (channel % 10) + 2.0 * shot
            y = 0.35 * (channel // 10)
            line = np.array([x, y, 0.0]) - [x, *origin[1:]]
            line /= np.linalg.norm(line)
            deep = second is not None and rng.random() < 1 / 3
            found = [(r, 2) for r in rng.uniform(2400, 2700, rng.poisson(noise_per_m * 300))]
            if rng.random() < detection:
                field = second if deep and second is not None else height
                z = float(field(np.array([x]), np.array([y]))[0])
                first = (z - 2500) / line[2] + rng.normal(0, 0.04)
                found.append((first, 0))
            for r, of in list(found):
                if rng.random() < afterpulses:
                    lag = 0.24 + rng.exponential(0.7) + rng.normal(0, 0.03)
                    found.append((r + lag, 1 if of == 0 else 3))
            rows += [
                (shot * 2e-5, channel + 1 if channels else 0, x, origin[1:], line, r, kind)
                for r, kind in found
            ]
    points = np.array([[x, *o] + line * r for _, _, x, o, line, r, _ in rows])
    time, channel = np.array([row[0] for row in rows]), np.array([row[1] for row in rows])
    kind = np.array([row[6] for row in rows])
    columns = {"gps_time": time, "channel": channel}
    columns |= {k: np.rint(points[:, a] * 1000) for a, k in enumerate("xyz")}
    order = np.lexsort([points[:, 2], channel, time])
    table = PointTable({k: v[order].astype(COLUMNS[k].dtype) for k, v in columns.items()})
    ends = np.array([[-1e5, *origin[1:]], [1e5, *origin[1:]]])
    return table, Trajectory(np.array([-1.0, 1.0]), ends, 10.0), kind[order]


def found(
    table: PointTable, track: Trajectory, settings: AfterpulseSettings = SETTINGS
) -> NDArray[np.float32]:
    return candidates.assess(table, geometry.beams(table, track), settings, SENSOR)[0]


def test_places_across_a_beam_are_square_to_it() -> None:
    table, track, _ = shots(level, number=6)
    beams = geometry.beams(table, track)
    starts = run_starts(table["gps_time"])
    first = np.repeat(starts[:-1], np.diff(starts))
    u, v = afterpulse_law.across_beams(table, starts, beams.direction)[:, : len(table)]
    away = np.column_stack([(table[k] - table[k][first].astype(np.int64)) / 1000 for k in "xyz"])
    along = np.sum(away * beams.direction[first], axis=1)
    np.testing.assert_allclose(u**2 + v**2 + along**2, np.sum(away**2, axis=1), atol=1e-9)
    assert np.abs(np.corrcoef(u, v)[0, 1]) < 0.9


def eave(_: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Half on a roof, half on the ground 3 m below it."""
    return np.where(y > 1.5, 3.0, 0.0)


def level(x: NDArray[np.float64], _: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.zeros_like(x)


@pytest.mark.parametrize(
    ("height", "removed"),
    # A shot has one hard surface; behind its second one planes in space decide.
    [(level, 0.95), (lambda x, y: 0.5 * y + 0 * x, 0.95), (eave, 0.45)],
)
def test_afterpulses_go_and_surfaces_stay(height: Height, removed: float) -> None:
    table, track, kind = shots(height)
    flagged = found(table, track) >= 0.5
    assert flagged[kind == 1].mean() >= removed
    assert flagged[kind == 0].mean() <= 0.003
    assert flagged[kind == 2].mean() <= 0.03


def test_without_channels_the_plane_decides() -> None:
    table, track, kind = shots(level, channels=False, noise_per_m=0.0)
    flagged = found(table, track) >= 0.5
    assert flagged[kind == 1].mean() >= 0.8
    assert flagged[kind == 0].mean() <= 0.003


def test_as_published_all_below_the_plane_goes_whether_or_not_beamlets_are_known() -> None:
    published = SETTINGS.model_copy(update={"method": "published"})
    for channels in (True, False):
        table, track, kind = shots(level, channels=channels, noise_per_m=0.0)
        flagged = found(table, track, published) >= 0.5
        below = table["z"] < -320
        assert flagged[below].all()
        assert not flagged[table["z"] > -280].any()
        assert flagged[kind == 1].mean() >= 0.8

    def apart(_: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.where(y > 0.3, 12.0, 0.0)

    # Ours keeps the ground beside a roof; the source has one plane and takes what lies below.
    table, track, kind = shots(apart, detection=0.9, afterpulses=0.0)
    ground = (kind == 0) & (table["z"] < 1000)
    assert not (found(table, track) >= 0.5)[ground].any()
    assert (found(table, track, published) >= 0.5)[ground].mean() > 0.9


def test_a_sea_bed_seen_by_first_returns_lives() -> None:
    table, track, kind = shots(level, second=lambda x, _: np.full_like(x, -1.5), afterpulses=0.0)
    flagged = found(table, track) >= 0.5
    assert flagged[kind == 0].sum() == 0


def test_vegetation_is_left_to_the_space_domain() -> None:
    rng = np.random.default_rng(0)

    def crown(x: NDArray[np.float64], _: NDArray[np.float64]) -> NDArray[np.float64]:
        return rng.uniform(4, 14, x.shape)

    table, track, kind = shots(crown, detection=0.6)
    p = found(table, track)
    assert (p[kind == 0] >= 0.5).mean() <= 0.002
    followers = p[(kind == 1) & (p > 0)]
    assert followers.max() < 0.5
    assert followers.mean() > p[kind == 0].mean()


@pytest.mark.parametrize("longest", [0.8, 3.0])
def test_no_return_is_an_afterpulse_farther_behind_than_the_longest_lag(longest: float) -> None:
    # The bottom of water would be, as far as settings look behind a hard surface.
    sensor = SENSOR.model_copy(update={"afterpulse_lag_max_m": longest})
    table, track, kind = shots(level, noise_per_m=2e-3, number=20)
    beams = geometry.beams(table, track)
    p, rate = candidates.assess(table, beams, SETTINGS, sensor)
    due = rate > 0
    assert (p[~due] == 0).all()
    assert (p[due] > 0).all()
    assert (p[due & (kind == 1)] >= 0.5).mean() > 0.9
    assert (found(table, track)[~due] > 0).any() == (longest < 3)


def test_shots_stand_alone_and_rows_may_be_cut_between_them() -> None:
    table, track, _ = shots(eave, number=TOGETHER + 12)
    whole = found(table, track)
    assert np.count_nonzero(whole) > TOGETHER
    parts = [found(table.take(table["gps_time"] == t), track) for t in np.unique(table["gps_time"])]
    assert np.array_equal(np.concatenate(parts), whole)


def test_disabled_or_without_beams_nothing_is_flagged() -> None:
    table, track, _ = shots(level, number=3)
    assert found(table, track, AfterpulseSettings(enabled=False)).max() == 0
    away = Trajectory(np.array([50.0, 51.0]), np.zeros((2, 3)))
    assert found(table, away).max() == 0
    assert len(found(table.take(slice(0, 0)), track)) == 0


def test_a_single_return_and_coincident_ones_are_harmless() -> None:
    table, track, _ = shots(level, number=2)
    assert found(table.take(slice(0, 1)), track).tolist() == [0.0]
    same = table.take(np.zeros(30, dtype=np.int64))
    assert np.isfinite(found(same, track)).all()
