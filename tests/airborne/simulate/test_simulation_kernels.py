"""Scene and receiver kernels against slow twins and against the theory."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import optimize, stats

from spl_batch.airborne.beams.link_budget import link_constant
from spl_batch.airborne.sensors.sensor import load_preset
from spl_batch.airborne.simulate import (
    detector,
    flight,
    preset_scene,
)
from spl_batch.airborne.simulate.brightness import physical_noise
from spl_batch.airborne.simulate.scene import beam_layers, ray_trace
from spl_batch.airborne.simulate.scene.landscape import Building, Wires
from spl_batch.airborne.simulate.scene.layout import (
    building_solid,
    catenary,
    lay_out,
    tower_solid,
)
from spl_batch.airborne.simulate.scene.scene_file import parse_scene
from spl_batch.errors import WorkflowError
from spl_batch.numerics import attitude


def slanted(rng, off_nadir_deg=18.0):
    turn, lean = rng.uniform(0, 2 * np.pi), math.radians(rng.uniform(0, off_nadir_deg))
    return np.array(
        [math.sin(lean) * math.cos(turn), math.sin(lean) * math.sin(turn), -math.cos(lean)]
    )


def origin_for(target, direction, range_m=2000.0):
    return np.asarray(target) - range_m * direction


def bare(z, kind=ray_trace.KIND_GROUND, ponds=(), steep_top=-math.inf):
    """Ground of nodes 1 m apart."""
    shape = z.shape
    return ray_trace.Ground(
        z, np.full(shape, 0.2), np.full(shape, kind, np.uint8), np.array([0.0, 0.0, 1.0]),
        np.zeros(shape, np.uint8), np.array(ponds, np.float64).reshape(-1, 4), steep_top,
    )  # fmt: skip


def test_ground_hit_agrees_with_root_finding():
    rng = np.random.default_rng(1)
    y, x = np.mgrid[0:81, 0:81] * 1.0
    ground = bare(20 + 5 * np.sin(x / 9) * np.cos(y / 11))
    for _ in range(50):
        d = slanted(rng)
        o = origin_for([rng.uniform(15, 65), rng.uniform(15, 65), 20.0], d)

        def above(t, o=o, d=d):
            p = o + t * d
            return p[2] - ray_trace.bilinear(ground.z, ground.grid, p[0], p[1])[0]

        t, cosine = ray_trace.meet_ground(ground, o, d)
        assert t == pytest.approx(optimize.brentq(above, 1900, 2100), abs=1e-3)
        p = o + t * d
        _, sx, sy = ray_trace.bilinear(ground.z, ground.grid, p[0], p[1])
        normal = np.array([-sx, -sy, 1.0]) / math.sqrt(1 + sx**2 + sy**2)
        assert cosine == pytest.approx(-normal @ d, abs=1e-3)


def test_steep_ground_is_met_where_marching_along_the_ray_meets_it_first():
    rng = np.random.default_rng(4)
    y, x = np.mgrid[0:41, 0:41] * 1.0
    z = 15.0 * ((x > 14) & (y > 12) & (x < 27)) + 0.1 * x
    ground = bare(z, steep_top=float(z.max()))
    for _ in range(60):
        d = slanted(rng)
        o = origin_for([rng.uniform(8, 33), rng.uniform(8, 33), rng.uniform(0, 18)], d, 100.0)
        t, cosine = ray_trace.meet_ground(ground, o, d)
        along = np.arange(70.0, 125.0, 0.01)
        places = o + along[:, None] * d
        below = [p[2] <= ray_trace.bilinear(z, ground.grid, p[0], p[1])[0] for p in places]
        assert t == pytest.approx(along[np.argmax(below)], abs=0.011)
        assert 0.0 <= cosine <= 1.0


def test_bilinear_interpolates_a_plane_exactly_and_gives_its_slope():
    y, x = np.mgrid[0:9, 0:7] * 2.0
    value = ray_trace.bilinear(3 + 0.25 * x - 0.5 * y, np.array([10.0, 20.0, 2.0]), 13.3, 27.7)
    assert value == pytest.approx((3 + 0.25 * 3.3 - 0.5 * 7.7, 0.25, -0.5))


@pytest.mark.parametrize("roof", ["flat", "gable", "shed"])
def test_a_building_is_hit_where_marching_along_the_ray_enters_it(roof):
    house = Building(centre_m=(33, 34), size_m=(16, 9), heading_deg=33, eave_m=6, roof=roof)
    planes = building_solid(house, bare(np.zeros((60, 60)))).planes
    rng, hits = np.random.default_rng(2), 0
    for _ in range(200):
        d = slanted(rng)
        o = origin_for([*rng.uniform(22, 44, 2), rng.uniform(0, 8)], d, 100.0)
        enter, leave, face = ray_trace.clip_convex(planes, o, d)
        t = np.arange(80.0, 130.0, 0.01)
        p = o + t[:, None] * d
        within = (p @ planes[:, :3].T <= planes[:, 3]).all(axis=1)
        if within.any():
            hits += 1
            assert enter == pytest.approx(t[within][0], abs=0.011)
            assert planes[face, :3] @ (o + enter * d) == pytest.approx(planes[face, 3])
        else:
            assert leave - enter < 0.011 or enter > 130  # walls go on below the ground
    assert 40 < hits < 190


def test_a_tower_narrows_from_its_foot_to_its_tip():
    wires = Wires(points_m=((30, 30), (40, 30)), height_m=28)
    planes = tower_solid(30.0, 30.0, wires, bare(np.full((60, 60), 7.0))).planes

    def inside(aside, z):
        return (planes[:, :3] @ [30 + aside, 30.0, z] <= planes[:, 3]).all()

    for half_m, z in ((2.5, 7.0), (0.8, 40.0)):
        for side in (-1, 1):
            assert inside(side * (half_m - 0.01), z - 1e-6)
            assert not inside(side * (half_m + 0.01), z - 1e-6)
    assert not inside(0.0, 40.1)


def test_crown_chord_is_the_quadratic_of_the_ellipsoid():
    rng = np.random.default_rng(3)
    crown = np.array([5.0, -3.0, 12.0, 3.0, 5.0, 0.4, 0.3, 0.0])
    size = np.array([3.0, 3.0, 5.0])
    for _ in range(100):
        d = slanted(rng)
        o = origin_for(crown[:3] + rng.uniform(-4, 4, 3), d, 300.0)
        p, u = (o - crown[:3]) / size, d / size
        roots = np.roots([u @ u, 2 * p @ u, p @ p - 1])
        enter, leave = ray_trace.clip_crown(crown, o, d)
        if np.iscomplex(roots).any():
            assert leave <= enter
        else:
            np.testing.assert_allclose([enter, leave], np.sort(roots), atol=1e-6)


@given(
    span=st.floats(20, 300),
    rise=st.floats(-10, 10),
    sag=st.floats(0.2, 8),
)
@settings(max_examples=60, deadline=None)
def test_catenary_passes_its_ends_with_its_sag(span, rise, sag):
    a, vertex, offset = catenary(span, 20.0, 20.0 + rise, sag)
    wire = np.array([0, 0, 1, 0, span, a, vertex, offset, 0.01, 0.4])
    z = [ray_trace.catenary_z(wire, s) for s in (0.0, span / 2, span)]
    # a nearly straight wire has a huge parameter: 1e-16 of it is what cosh leaves
    assert z == pytest.approx([20.0, 20 + rise / 2 - sag, 20 + rise], abs=1e-4)


def test_distance_of_a_ray_from_a_wire_is_the_smallest_one():
    rng = np.random.default_rng(4)
    a, vertex, offset = catenary(90.0, 25.0, 28.0, 3.0)
    heading = 0.7
    ux, uy = math.cos(heading), math.sin(heading)
    wire = np.array([2.0, 3.0, ux, uy, 90.0, a, vertex, offset, 0.015, 0.4])

    def place(s):
        return np.array([2 + s * ux, 3 + s * uy, ray_trace.catenary_z(wire, s)])

    for _ in range(60):
        d = slanted(rng)
        o = origin_for(place(rng.uniform(5, 85)) + rng.uniform(-0.3, 0.3, 3), d)

        def miss(s, o=o, d=d):
            q = place(s) - o
            return np.linalg.norm(q - (q @ d) * d)

        best = optimize.minimize_scalar(
            miss, bounds=(0, 90), method="bounded", options={"xatol": 1e-9}
        )
        t, distance = ray_trace.meet_wire(wire, o, d)
        assert distance == pytest.approx(best.fun, abs=1e-3)
        assert t == pytest.approx((place(best.x) - o) @ d, abs=0.3)


def test_signal_follows_equation_2_1():
    constant = link_constant(load_preset("spl100"))
    h_nu = 6.62607015e-34 * 299792458 / 532e-9
    area = math.pi * 0.038**2
    expected = 0.8 * 0.2 * 0.05 * 0.83e-6 / h_nu * 0.25 * area / (math.pi * 2588**2)
    assert constant * 0.25 / 2588**2 == pytest.approx(expected)


def test_sunlight_from_the_ground_passes_the_air_below_twice():
    tiny = preset_scene("tiny")
    clear, hazy = (
        physical_noise(tiny.model_copy(update={"sky": tiny.sky.model_copy(update=sky)}))
        for sky in ({"extinction_per_m": 0.0}, {"extinction_per_m": 1e-4})
    )
    assert clear.ground_share == 1.0
    altitude, scale = tiny.flights[0].altitude_agl_m, tiny.sky.scale_height_m
    z = np.linspace(altitude, 200_000.0, 400_001)
    above = np.trapezoid(1e-4 * np.exp(-z / scale), z)
    path = sum(1 / math.cos(math.radians(angle)) for angle in (15.0, tiny.sky.zenith_deg))
    passed = math.exp(-above * path * (1 - math.exp(-altitude / scale)))
    ground = hazy.ground_share * hazy.solar_per_m / clear.solar_per_m
    assert ground == pytest.approx(passed, rel=1e-6)
    assert 0.1 < hazy.ground_share < 1.0
    assert hazy.dark_per_m == pytest.approx(2 * 30_000 / 299_792_458)


def test_central_vector_follows_equation_2_12():
    cone = math.radians(15)
    for angle in (0.0, 0.8, 2.5, 5.0):
        c, s = math.cos(-angle), math.sin(-angle)
        turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        c, s = math.cos(2 * math.pi - cone), math.sin(2 * math.pi - cone)
        tilt = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
        expected = turn @ tilt @ np.array([0, 0, -1.0])
        # Eq. 2.12 as printed puts y on the other side than Eq. 2.13, which is used
        got = flight.central_vectors(np.array([angle]), cone)[0]
        np.testing.assert_allclose(np.abs(got), np.abs(expected), atol=1e-12)
        np.testing.assert_allclose(
            got, [np.sin(cone) * np.sin(angle), np.sin(cone) * np.cos(angle), -np.cos(cone)]
        )


def test_heading_roll_and_pitch_turn_the_body_the_way_pilots_mean():
    quarter = np.array([math.pi / 2])
    zero = np.array([0.0])
    small = np.array([0.1])
    np.testing.assert_allclose(
        attitude.rotations(quarter, zero, zero)[0] @ [0, 1, 0], [1, 0, 0], atol=1e-12
    )
    assert (attitude.rotations(zero, small, zero)[0] @ [1, 0, 0])[2] < 0
    assert (attitude.rotations(zero, zero, small)[0] @ [0, 1, 0])[2] > 0


def room(n=400):
    return (
        np.empty(n),
        np.empty((n, 3), dtype=np.int64),
        np.empty(n, dtype=np.int64),
        np.empty(n, dtype=np.int64),
    )


def test_background_is_uniform_along_the_gate():
    rng, (ranges, facts, _, _) = np.random.default_rng(6), room()
    seen, counts = [], []
    for _ in range(1500):
        n = detector.add_background(rng, ranges, facts, (1000.0, 1300.0), 0.01)
        counts.append(n)
        seen.extend(ranges[:n])
    assert np.mean(counts) == pytest.approx(3.0, abs=4 * math.sqrt(3 / 1500))
    assert stats.kstest(seen, stats.uniform(1000, 300).cdf).pvalue > 1e-4


def test_dead_time_is_kept_and_what_falls_into_it_is_counted():
    rng, (ranges, facts, kept, electrons) = np.random.default_rng(7), room()
    receiver = detector.Receiver(0.24, 0.0, 0.7, 3.0)
    for _ in range(200):
        n = detector.add_background(rng, ranges, facts, (0.0, 30.0), 3.0)
        before = ranges[:n].copy()
        count = detector.record(rng, ranges, facts, n, 30.0, receiver, kept, electrons)
        expected, last = [], -np.inf
        for k, at in enumerate(before):
            if at >= last + 0.24:
                expected.append(k)
                last = at
        np.testing.assert_array_equal(kept[:count], expected)
        assert electrons[:count].sum() == n


def test_afterpulses_follow_their_law_and_name_their_parents():
    rng, (ranges, facts, kept, electrons) = np.random.default_rng(8), room()
    receiver, lags, generations, n_shots = detector.Receiver(0.24, 0.15, 0.7, 3.0), [], [], 6_000
    for _ in range(n_shots):
        n = detector.add_event(ranges, facts, 0, 50.0, 2, detector.NO_PARENT, -1)
        count = detector.record(rng, ranges, facts, n, 300.0, receiver, kept, electrons)
        generations.append(count - 1)
        assert (facts[1:count, 0] == ray_trace.KIND_AFTERPULSE).all()
        assert (facts[1:count, 1] == 2).all()  # the surface, through every generation
        lags.extend(ranges[k] - ranges[facts[k, 2]] for k in range(1, count))
    started = np.bincount(generations, minlength=3)
    # every recorded detection starts one with p: a geometric number of generations
    for k in range(3):
        p = 0.85 * 0.15**k
        assert started[k] / n_shots == pytest.approx(p, abs=4 * math.sqrt(p / n_shots))
    law = stats.truncexpon(b=(3.0 - 0.24) / 0.7, loc=0.24, scale=0.7)
    assert stats.kstest(lags, law.cdf).pvalue > 1e-4


def test_a_tail_takes_its_share_of_the_lags():
    power = 1.5
    receiver = detector.Receiver(0.24, 0.2, 0.5, 15.0, 0.4, 3.0, power)
    rng, window = np.random.default_rng(4), 15.0 - 0.24
    lags = np.array([detector.draw_lag(rng, receiver) for _ in range(8_000)]) - 0.24

    def tail(x):
        rest = (1 + window / 3.0) ** (1 - power)
        return (1 - (1 + np.clip(x, 0, window) / 3.0) ** (1 - power)) / (1 - rest)

    def law(x):
        return 0.6 * stats.truncexpon(b=window / 0.5, scale=0.5).cdf(x) + 0.4 * tail(x)

    assert stats.kstest(lags, law).pvalue > 1e-4
    assert lags.min() >= 0.0
    assert lags.max() <= window


def test_clear_water_is_a_surface_a_column_and_a_bottom():
    ground = bare(np.full((20, 20), 8.0), ray_trace.KIND_BOTTOM, [(10.0, 0.3, 0.04, 0.02)])
    scene = ray_trace.SceneArrays(
        ground, np.zeros((0, 6, 4)), np.zeros((0, 4)), np.zeros((0, 8)), np.zeros((0, 10)),
        np.array([0.0, 0.0, 20.0]), np.zeros((1, 2), np.int64), np.zeros(0, np.int64),
    )  # fmt: skip
    d = np.array([math.sin(0.2), 0.0, -math.cos(0.2)])
    o = origin_for([10.0, 10.0, 8.0], d, 500.0)
    layers = beam_layers.empty_layers(scene)
    n, hard, _, rho, what = beam_layers.look(scene, o, d, d, 1e-4, layers)
    assert (n, what, rho) == (2, ray_trace.KIND_BOTTOM, pytest.approx(0.2))
    assert hard == pytest.approx(500.0)
    length = 2.0 / math.cos(0.2)
    assert layers[:2, 0] == pytest.approx([500.0 - length] * 2)
    assert layers[0, 2] * layers[0, 3] == pytest.approx(0.04), "the surface's reflectance"
    assert 1 - layers[1, 2] == pytest.approx(math.exp(-2 * 0.3 * length)), "both ways"
    assert layers[1, 3] == 0.0
    ground.kind[:] = ray_trace.KIND_WATER
    assert beam_layers.look(scene, o, d, d, 1e-4, layers)[0] == 0, "opaque water is its surface"


def test_a_flightline_beside_the_scene_is_refused():
    scene = parse_scene({"extent_m": [9, 9], "flights": [{"heading_deg": 0, "offset_m": 3e3}]}, "")
    with pytest.raises(WorkflowError, match=r"flights\.0: no shot meets .* choose a smaller one"):
        flight.make_passes(scene, lay_out(scene).arrays)


def test_no_shot_near_the_scene_is_passed_over():
    tiny = preset_scene("tiny")
    scene = tiny.model_copy(
        update={
            "terrain": tiny.terrain.model_copy(update={"relief_m": 60.0}),
            "acquisition": tiny.acquisition.model_copy(update={"prf_hz": 6000, "wobble_deg": 2.0}),
        }
    )
    arrays, found = lay_out(scene).arrays, 0
    for run in flight.make_passes(scene, arrays):
        shots_of = np.arange(math.ceil(2 * run.half_s + 2) * scene.acquisition.prf_hz)
        ground, range_m = flight.ground_points(run, shots_of.astype(np.int64), arrays)
        outside = np.maximum(-ground[:, :2], ground[:, :2] - scene.extent_m).max(axis=1)
        reach = flight.array_reach_m(scene, run.flight) + scene.acquisition.margin_m
        expected = np.flatnonzero(outside <= reach)
        np.testing.assert_array_equal(np.concatenate([p.shot for p in run.chunks]), expected)
        ranges = np.concatenate([p.ground_range_m for p in run.chunks])
        np.testing.assert_allclose(ranges, range_m[expected], rtol=1e-12)
        found += len(expected)
    assert found > 100
