"""A whole run of a small survey against its truth: afterpulses as pairs, water, reflectance."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.airborne.afterpulse.afterpulse_scenes import clumps
from benchmarks.airborne.products import intensity
from benchmarks.airborne.quality import KINDS, _load
from spl_batch.airborne.simulate import simulate
from spl_batch.airborne.simulate.scene.scene_file import Scene, parse_scene
from spl_batch.lattice.tiles import Bounds
from tests import surveys

pytestmark = pytest.mark.slow

ROOFS: list[dict[str, Any]] = [
    {"centre_m": [10 + 19 * (k % 3), 9 + 16 * (k // 3)], "size_m": [14, 11],
     "heading_deg": 10 * k, "eave_m": 5, "pitch_deg": 30, "roof": ("flat", "gable", "shed")[k % 3],
     "reflectance": (0.05, 0.6, 0.2, 0.8, 0.1, 0.4)[k]}
    for k in range(6)
]  # fmt: skip

SCENE: Scene = parse_scene(
    {
        "name": "pairs", "seed": 12, "extent_m": [58, 64],
        "terrain": {"relief_m": 4, "wavelength_m": 60, "reflectance_variation": 0.4},
        "buildings": {"list": ROOFS}, "trees": clumps(cover=0.25),
        "water": [{"ring_m": [[30, 40], [54, 40], [54, 60], [30, 60]], "bank_slope": 0.5,
                   "depth_m": 2.0}],
        "flights": [{"heading_deg": 20, "offset_m": 250, "speed_m_s": 100},
                    {"heading_deg": 130, "offset_m": -200, "speed_m_s": 100,
                     "altitude_agl_m": 1800}],
        "sky": {"background_per_m3": 0.05},
        "acquisition": {"prf_hz": 40_000, "gate_m": 100, "margin_m": 2, "dead_channels": [7, 53],
                        "weak_channels": {17: 0.2}},
    },
    "pairs",
)  # fmt: skip


@pytest.fixture(scope="module")
def survey(tmp_path_factory: pytest.TempPathFactory) -> Path:
    workflow = simulate(SCENE, tmp_path_factory.mktemp("pairs")).workflow
    assert surveys.run(workflow).exit_status == 0
    return workflow.parent


def test_afterpulses_go_and_what_they_follow_stays(survey: Path) -> None:
    """Of each surface: afterpulses of it that are removed, its own returns called afterpulses."""
    points = _load(survey)
    kind, parent, given = points["kind"], points["parent"], points["noise_class"]
    numbers = {name: k for k, name in enumerate(KINDS)}
    for name, removed, lost in (
        ("roof", 0.97, 0.003), ("ground", 0.97, 0.003), ("vegetation", 0.6, 0.02),
    ):  # fmt: skip
        echo = (kind == numbers["afterpulse"]) & (parent == numbers[name])
        true = kind == numbers[name]
        assert min(echo.sum(), true.sum()) > 1000
        assert (given[echo] != 0).mean() >= removed, name
        assert (given[true] == 2).mean() <= lost, name


def test_the_bottom_of_clear_water_stays_below_its_surface(survey: Path) -> None:
    points = _load(survey)
    bottom = points["kind"] == KINDS.index("bottom")
    water = points["kind"] == KINDS.index("water")
    assert (points["noise_class"][bottom] == 0).mean() >= 0.95
    given = points["classification"]
    east, north = (points[axis] - at for axis, at in zip("xy", SCENE.origin_m, strict=False))
    inner = (east > 30) & (east < 54) & (north > 40) & (north < 60)
    assert (given[water & inner] == 9).mean() >= 0.97
    level = np.median(points["z"][water])
    deep = bottom & (points["z"] < level - 0.5)
    assert deep.sum() > 1000
    assert (given[deep] == 1).mean() >= 0.95


def test_reflectance_explains_its_truth(survey: Path) -> None:
    """R2 about the 1:1 line, over roofs and what is left between trees."""
    west, south = (round(1000 * v) for v in SCENE.origin_m[:2])
    size = [round(1000 * v) for v in SCENE.extent_m]
    cell = Bounds(west, south, west + size[0], south + size[1])
    found = intensity.cut(survey / "out" / "intensity.tif", cell)
    truth = intensity.raster(survey / "truth" / "reflectance.tif")
    patch = intensity.patches(survey, SCENE)
    # Light that comes back from clear water is its bottom's as well.
    patch[2:26, 28:56] = 0
    assert len(np.unique(patch[patch > 0])) >= len(ROOFS)
    _, explained, ratio = intensity.scores(
        intensity.means(found, patch), intensity.means(truth, patch)
    )
    assert explained >= intensity.BAR
    assert 0.95 < ratio < 1.05
