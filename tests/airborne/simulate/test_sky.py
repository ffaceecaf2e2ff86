"""Air and stray light of simulated surveys against what their settings say."""

import laspy
import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy import stats

from spl_batch.airborne.simulate import air as layers
from spl_batch.airborne.simulate import simulate
from spl_batch.airborne.simulate.scene.layout import lay_out
from spl_batch.airborne.simulate.scene.ray_trace import KINDS
from spl_batch.airborne.simulate.scene.scene_file import parse_scene
from spl_batch.airborne.simulate.sunlight import lit, sunlight
from spl_batch.errors import WorkflowError

FLAT = {
    "extent_m": [40, 40],
    "seed": 3,
    "terrain": {"relief_m": 0, "roughness_m": 0},
    "flights": [{"heading_deg": 0, "offset_m": 300, "speed_m_s": 110}],
    "acquisition": {"prf_hz": 20000, "gate_m": 160},
    "sensor_overrides": {"afterpulse_probability": 0.0},
}


def fly(out, sky=None, acquisition=None, **more):
    scene = {**FLAT, "sky": {"background_per_m3": 0.01, "variation": 0, **(sky or {})}, **more}
    scene["acquisition"] = {**FLAT["acquisition"], **(acquisition or {})}
    simulate(parse_scene(scene, "here"), out)
    las = laspy.read(out / "flightlines" / "line_01.laz")
    truth = pq.read_table(out / "truth" / "line_01.parquet")
    inside = (abs(las.x - 272_020) < 20) & (abs(las.y - 3_290_020) < 20)
    columns = {n: np.asarray(las[n]) for n in ("x", "y", "z", "gps_time", "channel")}
    columns["kind"] = truth["kind"].to_numpy()
    return {n: values[inside] for n, values in columns.items()}


def above_ground(points):
    return points["z"][points["kind"] == KINDS.index("background")] - 40.0


def test_a_layer_adds_what_its_strength_says_and_only_there(tmp_path):
    layer = {"base_m": 20, "top_m": 50, "times_noise": 6, "cover": 1, "edge_m": 0}
    height = above_ground(fly(tmp_path, {"haze": [layer]}))
    count = np.histogram(height, [-60, 0, 20, 50, 70])[0] / [60, 20, 30, 20]
    assert count[2] / count[[0, 1, 3]].mean() == pytest.approx(7, rel=0.12)
    assert stats.kstest(height[(height > 20) & (height < 50)], "uniform", (20, 30)).pvalue > 1e-3


def test_patches_cover_the_share_of_the_sky_that_is_asked_for_and_drift_with_the_wind():
    scene = parse_scene(
        {**FLAT, "sky": {"haze": [{"cover": 0.3, "patch_m": 50, "drift_m_s": [4, -2]}]}}, "here"
    )
    air = layers.make_air(scene, 1.0)
    rng = np.random.default_rng(1)
    at = rng.uniform(0, 3000, (20_000, 2))
    strength = [layers.patch_strength(air.layers[0], air.waves[0], *place, 0.0) for place in at]
    assert np.mean(strength) == pytest.approx(0.3, abs=0.03)
    later = [
        layers.patch_strength(air.layers[0], air.waves[0], x + 4 * 7.0, y - 2 * 7.0, 7.0)
        for x, y in at[:200]
    ]
    np.testing.assert_allclose(later, strength[:200], atol=1e-9)


def test_fog_thins_out_with_the_height_above_the_ground():
    scene = parse_scene({**FLAT, "sky": {"fog": [{"times_noise": 20, "scale_m": 1.5}]}}, "here")
    arrays, air = lay_out(scene).arrays, layers.make_air(scene, 0.05)
    rng, ranges, facts = np.random.default_rng(2), np.empty(200), np.empty((200, 3), np.int64)
    # down to half a metre below the ground, where there is no fog
    ray, span = (np.array([20.0, 20.0, 140.0]), np.array([0.0, 0.0, -1.0])), (0.0, 100.5)
    height = []
    for _ in range(2000):
        n = layers.add_air(rng, arrays, air, 1.0, 0.0, ray, span, ranges, facts, 0)
        height.extend(100.0 - ranges[:n])
    assert len(height) / 2000 == pytest.approx(20 * 0.05 * 1.5, rel=0.05)
    assert stats.kstest(height, "expon", (0, 1.5)).pvalue > 1e-3


def test_a_layer_upside_down_is_refused():
    with pytest.raises(WorkflowError, match=r"haze\.0: top_m must be above base_m"):
        parse_scene({**FLAT, "sky": {"haze": [{"base_m": 50, "top_m": 20}]}}, "here")


def box(**sky):
    """A scene with a house 10 m high, its light, and the step of its nodes."""
    house = {"centre_m": [20, 20], "size_m": [10, 10], "eave_m": 10, "reflectance": 0.8}
    scene = parse_scene({**FLAT, "buildings": {"list": [house]}, "sky": sky}, "here")
    return lit(scene, lay_out(scene).arrays)


def at(arrays, x, y):
    step = arrays.ground.grid[2]
    return arrays.ground.light[
        round((y - arrays.ground.grid[1]) / step), round((x - arrays.ground.grid[0]) / step)
    ]


def test_houses_cast_shadows_away_from_the_sun_as_long_as_it_stands_low():
    # the sun in the south at 45 degrees: the shadow reaches as far north as the house is high
    arrays = box(zenith_deg=45, azimuth_deg=180, skylight=0.2)
    assert at(arrays, 20, 30) == pytest.approx(0.2 * at(arrays, 20, 5))
    assert at(arrays, 20, 38) == at(arrays, 8, 30) == at(arrays, 20, 5)
    low = box(zenith_deg=70, azimuth_deg=180, skylight=0.2)
    assert at(low, 20, 38) == pytest.approx(0.2 * at(low, 20, 5))


def test_slopes_to_the_sun_are_brighter_than_those_away_from_it():
    scene = parse_scene({**FLAT, "sky": {"zenith_deg": 60, "azimuth_deg": 90, "skylight": 0}}, "")
    rise = 0.3 * np.abs(np.arange(41.0) - 20)
    light = sunlight(np.tile(rise, (5, 1)), 1.0, scene)[2]
    across = np.hypot(1.0, 0.3)
    slope = 0.3 * np.tan(np.radians(60))
    np.testing.assert_allclose(light[1:19], (1 + slope) / across)
    np.testing.assert_allclose(light[22:39], (1 - slope) / across)


def test_a_beamlet_over_a_bright_roof_hears_more_background_than_one_over_its_shadow(tmp_path):
    house = {"centre_m": [20, 20], "size_m": [16, 16], "eave_m": 10, "reflectance": 0.9}
    sky = {"background_per_m3": 0.05, "by_albedo": True, "zenith_deg": 70, "azimuth_deg": 180}
    points = fly(tmp_path, sky, buildings={"list": [house]})
    noise = points["kind"] == KINDS.index("background")
    # beams lean by 15 degrees at the most: what is this near to the ground lies above its place
    near = noise & (abs(points["z"] - 45) < 15)
    x, y = points["x"][near] - 272_000, points["y"][near] - 3_290_000
    roof, shade, sunny = (
        np.count_nonzero((abs(x - 20) < 5) & (abs(y - north) < 3)) for north in (20, 33, 6)
    )
    assert roof > 2 * sunny > 2.5 * shade > 0


def test_parcels_have_a_reflectance_each():
    scene = parse_scene({**FLAT, "terrain": {**FLAT["terrain"], "parcel_m": 20}}, "here")
    plain = parse_scene(FLAT, "here")
    factor = lay_out(scene).arrays.ground.rho / lay_out(plain).arrays.ground.rho
    values, count = np.unique(factor.round(6), return_counts=True)
    assert 20 < len(values[count > 20]) < 120
    assert values.max() / values.min() > 3
