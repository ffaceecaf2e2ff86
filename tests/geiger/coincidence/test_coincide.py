"""The synthetic scene, the stage, and what comes of both."""

import math
from functools import cache

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from spl_batch.geiger.coincidence.scene_rays import _leaves, opaque
from spl_batch.geiger.coincidence.settings import ArraySettings, CoincidenceSettings
from spl_batch.geiger.coincidence.simulate import POSITIONS_M, SceneSettings, build
from spl_batch.geiger.coincidence.surface import coincide
from spl_batch.geiger.coincidence.tables import Detections, Frames, Points
from spl_batch.lattice.tiles import Bounds, cell_bounds, cells_touching
from tests.geiger.coincidence.coincidence_scene import SMALL, flown, local, region

CHOSEN = CoincidenceSettings()


def made(frames: Frames, detections: Detections, chosen: CoincidenceSettings = CHOSEN) -> Points:
    return coincide.coincide(frames, detections, region(SMALL), chosen, SMALL.array)


@cache
def points(method: str = "bridge_sign") -> Points:
    return made(*flown(), CoincidenceSettings(method=method))


def same(a: Points, b: Points) -> bool:
    return all(np.array_equal(getattr(a, k), getattr(b, k)) for k in Points.__slots__)


def test_the_voxel_is_half_of_what_a_detector_sees() -> None:
    assert CHOSEN.voxel_quanta(ArraySettings()) == 45
    assert CHOSEN.voxel_quanta(ArraySettings(ifov_rad=40e-6)) == 60
    assert CoincidenceSettings(voxel_m=0.1).voxel_quanta(ArraySettings()) == 100


def test_detections_come_as_often_and_lie_where_they_should() -> None:
    frames, detections = flown()
    array, xyz = SMALL.array, local(detections.xyz)
    inside = (np.abs(xyz[:, :2] - SMALL.centre_m) < np.array(SMALL.extent_m) / 2).all(axis=1)
    bare = inside & (np.hypot(*xyz[:, :2].T) > 5.3)
    dark = np.abs(xyz[:, 2] - 1.0) > 2.0
    looks = len(frames) * array.detectors
    expected = looks * SMALL.flight.dark_rate_hz * 2 * 1000 / 299_792_458
    # Blocking hides a part of those behind the ground.
    assert 0.8 * expected < dark.sum() < expected
    height = xyz[bare & ~dark, 2]
    assert height.std() == pytest.approx(math.hypot(0.05, 0.05 / math.sqrt(12)), rel=0.05)
    assert abs(height.mean()) < 0.004
    # Ground gives 1 - exp(-0.25), spokes 1 - exp(-0.5).
    assert 1 - math.exp(-0.25) < (~dark).sum() / looks < 1 - math.exp(-0.5)
    away = detections.xyz / 1000 - frames.origin_m[np.searchsorted(frames.number, detections.frame)]
    # A range is the middle of its bin; positions are rounded to millimetres.
    assert (np.linalg.norm(away, axis=1) - 2500) / 0.05 % 1 == pytest.approx(0.5, abs=0.03)


def test_sight_errors_are_angles_in_fields_of_view() -> None:
    frames, detections = flown()
    assert coincide.sight_error(frames, detections, SMALL.array) < 0.05
    moved = Detections(detections.frame, detections.detector + 3, detections.xyz)
    kept = moved.take(moved.detector % SMALL.array.columns >= 3)
    assert coincide.sight_error(frames, kept, SMALL.array) == pytest.approx(3.0, abs=0.05)


@settings(deadline=None, max_examples=3)
@given(st.integers(1100, 3900), st.sampled_from([32, 57, 200]))
def test_no_cut_changes_a_point(tile: int, volume: int) -> None:
    frames, detections = flown()
    chosen = CoincidenceSettings(volume_voxels=volume)
    whole = region(SMALL)
    cells = list(cells_touching(whole, tile))
    assume(len(cells) > 1)  # a large tile may by chance hold all
    parts = []
    for cell in cells:
        b = cell_bounds(cell, tile)
        own = Bounds(max(b.xmin, whole.xmin), max(b.ymin, whole.ymin),
                     min(b.xmax, whole.xmax), min(b.ymax, whole.ymax))  # fmt: skip
        order = np.random.default_rng(tile).permutation(len(detections))
        parts.append(coincide.coincide(frames, detections.take(order), own, chosen, SMALL.array))
    assert same(Points.joined(parts).in_order(), points())


def test_frames_that_look_elsewhere_do_not_matter() -> None:
    frames, detections = flown()
    whole = region(SMALL)
    corner = Bounds(whole.xmin, whole.ymin, whole.xmin + 800, whole.ymin + 800)
    low, high = np.array([*corner[:2], 90_000]) / 1000, np.array([*corner[2:], 110_000]) / 1000
    rows = coincide.looking_at(frames, SMALL.array, low - 0.4, high + 0.4)
    assert 0 < len(rows) < len(frames)
    args = (detections, corner, CHOSEN, SMALL.array)
    found = coincide.coincide(frames.take(rows), *args)
    assert len(found) > 100
    assert same(found, coincide.coincide(frames, *args))


def off_m(xyz: np.ndarray) -> np.ndarray:
    """Height of points off the nearer of ground and target, with its sign."""
    off: np.ndarray = xyz[:, 2] - np.where(xyz[:, 2] > 1.0, 2.0, 0.0)
    return off


def filled(xyz: np.ndarray) -> float:
    """Share of the cells of 10 cm of the part looked at that hold a point."""
    at = np.floor((xyz[:, :2] - SMALL.centre_m + np.array(SMALL.extent_m) / 2) / 0.1)
    return len(np.unique(at, axis=0)) / np.prod(np.rint(np.array(SMALL.extent_m) / 0.1))


@pytest.mark.parametrize(("method", "near"), [("bridge_sign", 0.99), ("published", 0.95)])
def test_the_scene_comes_back(method: str, near: float) -> None:
    xyz = local(points(method).xyz)
    off = off_m(xyz)
    assert (np.abs(off) < 0.09).mean() > near
    assert np.abs(off).max() < 0.5
    assert filled(xyz) > 0.85
    on_spokes = off[xyz[:, 2] > 1.0]
    assert len(on_spokes) > 500
    assert abs(on_spokes.mean()) < 0.015


def test_the_published_method_differs_by_its_named_settings() -> None:
    named = {"threshold": 0.06, "wide_below": 0, "edge_rule": False, "edge_share": 0.0}
    named["strongest_along_normal"] = False
    chosen = CoincidenceSettings(bridge_sign=named).rules
    assert chosen == CoincidenceSettings(method="published").rules
    differ = {name for name, value in chosen if value != getattr(CHOSEN.rules, name)}
    assert differ == set(named)
    found = points("published")
    for name, other in (("edge_rule", True), ("edge_share", 0.8), ("strongest_along_normal", True)):
        one = CoincidenceSettings(bridge_sign={**named, name: other})
        assert 0 < len(made(*flown(), one)) < len(found)


def test_a_wider_window_fills_faint_surfaces() -> None:
    frames, detections = flown()
    faint = detections.take(np.random.default_rng(3).random(len(detections)) < 0.1)
    full, spread = [], []
    for wide_below in (0, 6):
        chosen = CoincidenceSettings(bridge_sign={"wide_below": wide_below})
        xyz = local(made(frames, faint, chosen).xyz)
        full.append(filled(xyz))
        spread.append(off_m(xyz).std())
    assert full[1] > full[0] + 0.02
    assert spread[1] < 0.95 * spread[0]


def test_nothing_comes_of_noise() -> None:
    frames, detections = flown()
    noise = detections.take(np.abs(local(detections.xyz)[:, 2] - 1.0) > 2.0)
    assert not len(made(frames, noise))
    # Ten detections at one point are no noise.
    centre = np.array([500_003_000, 4_200_000_500, 140_000])
    xyz = centre + np.random.default_rng(1).integers(-20, 20, (10, 3))
    added = Detections(frames.number[:10], np.zeros(10, np.int32), xyz)
    found = made(frames, added, CoincidenceSettings(bridge_sign={"threshold": 0.005}))
    assert len(found) >= 1
    assert np.abs(found.xyz - centre).max() < 200


def test_fewer_looks_make_a_point_brighter() -> None:
    """Half of the frames without their detections: every intensity falls by half."""
    frames, detections = flown()
    even = frames.number % 2 == 0
    kept = detections.take(detections.frame % 2 == 0)
    alone, both = made(frames.take(even), kept), made(frames, kept)
    assert np.median(alone.intensity) > 1.3 * np.median(both.intensity)


def test_leaves_are_listed_where_rays_meet_them() -> None:
    scene = build(SceneSettings(targets=("foliage",)))
    rng, met = np.random.default_rng(4), 0
    for _ in range(40):
        way = np.array([*rng.uniform(-0.06, 0.06, 2), -1.0])
        way /= np.linalg.norm(way)
        origin = np.array([*(POSITIONS_M["foliage"] + rng.uniform(-6.5, 6.5, 2)), 5.0]) - 3000 * way
        hit = np.empty(32, np.int64)
        n = _leaves(origin, way, scene, hit)
        t = (scene.leaves[:, 2] - origin[2]) / way[2]
        off = origin[:2] + t[:, None] * way[:2] - scene.leaves[:, :2]
        slow = np.flatnonzero((np.abs(off) <= scene.leaf_m / 2).all(axis=1))
        assert sorted(hit[:n].tolist()) == slow.tolist()
        assert (np.diff(scene.leaves[hit[:n], 2]) <= 0).all()
        met += n
    assert met > 40


@pytest.mark.parametrize(
    ("xy", "height", "target"),
    [
        ((25.0, 0.5), 2.0, True),
        ((25.0, 1.5), 0.0, False),
        ((28.0, -13.0), 0.0, True),
        ((-24.7 + 0.75, -24.7), 4.75 + 0.25, True),
        ((-24.7, -24.7), 0.0, False),
        ((4.0, 0.1), 2.0, True),
        ((4.0, -0.1), 0.0, False),
    ],
)
def test_what_a_ray_meets(xy: tuple[float, float], height: float, target: bool) -> None:  # noqa: FBT001
    scene = build(SceneSettings(targets=("spokes", "cube", "coil", "logo")))
    t, bright = opaque(np.array([*xy, 50.0]), np.array([0.0, 0.0, -1.0]), scene)
    assert bright is target
    assert 50 - t == pytest.approx(height, abs=0.002)
