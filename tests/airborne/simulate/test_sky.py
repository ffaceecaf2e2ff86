"""Air and stray light of simulated surveys against what their settings say."""

import laspy
import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy import stats

from spl_batch.airborne.simulate import haze, simulate
from spl_batch.airborne.simulate import survey as sky_of
from spl_batch.airborne.simulate.scene.scene_file import parse_scene
from spl_batch.airborne.simulate.survey import KINDS
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
    air = sky_of.make_air(scene, 1.0)
    rng = np.random.default_rng(1)
    at = rng.uniform(0, 3000, (20_000, 2))
    strength = [haze.patch_strength(air.layers[0], air.waves[0], *place, 0.0) for place in at]
    assert np.mean(strength) == pytest.approx(0.3, abs=0.03)
    later = [
        haze.patch_strength(air.layers[0], air.waves[0], x + 4 * 7.0, y - 2 * 7.0, 7.0)
        for x, y in at[:200]
    ]
    np.testing.assert_allclose(later, strength[:200], atol=1e-9)


def test_a_layer_upside_down_is_refused():
    with pytest.raises(WorkflowError, match=r"haze\.0: top_m must be above base_m"):
        parse_scene({**FLAT, "sky": {"haze": [{"base_m": 50, "top_m": 20}]}}, "here")
