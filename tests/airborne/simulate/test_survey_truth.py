"""A whole run of a small survey against its truth: afterpulses as pairs, water, reflectance."""

import json
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pyarrow.parquet as pq
import pytest
import rasterio
import shapely
from numpy.typing import NDArray

from spl_batch.airborne.simulate import simulate
from spl_batch.airborne.simulate.scene.scene_file import Scene, parse_scene
from spl_batch.airborne.simulate.survey import KINDS
from tests import surveys

pytestmark = pytest.mark.slow

ROOFS: list[dict[str, Any]] = [
    {"centre_m": [10 + 19 * (k % 3), 9 + 16 * (k // 3)], "size_m": [14, 11],
     "heading_deg": 10 * k, "eave_m": 5, "pitch_deg": 30, "roof": ("flat", "gable", "shed")[k % 3],
     "reflectance": (0.05, 0.6, 0.2, 0.8, 0.1, 0.4)[k]}
    for k in range(6)
]  # fmt: skip

CLUMPS = {"cover": 0.25, "height_m": [3, 16], "radius_m": [0.3, 0.5], "crown_share": 0.06,
          "extinction_per_m": 2.0, "gaps": 0.0, "understory": 0.0}  # fmt: skip

SCENE: Scene = parse_scene(
    {
        "name": "pairs", "seed": 12, "extent_m": [58, 64],
        "terrain": {"relief_m": 4, "wavelength_m": 60, "reflectance_variation": 0.4},
        "buildings": {"list": ROOFS}, "trees": CLUMPS,
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


def _load(survey: Path) -> dict[str, NDArray[Any]]:
    """Delivered points of all flightlines, with truth beside them."""
    parts: dict[str, list[NDArray[Any]]] = {}
    for path in sorted((survey / "truth").glob("line_*.parquet")):
        las = laspy.read(survey / "out" / "laz" / "flightlines" / f"{path.stem}.laz")
        truth = pq.read_table(path)
        for name in ("kind", "parent"):
            parts.setdefault(name, []).append(truth[name].to_numpy())
        for name in ("x", "y", "z", "noise_class", "classification"):
            parts.setdefault(name, []).append(np.asarray(las[name]))
    return {name: np.concatenate(values) for name, values in parts.items()}


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
    """R2 about the 1:1 line, over the means of roofs without their rim."""
    with rasterio.open(survey / "truth" / "reflectance.tif") as source:
        truth, bounds, at = source.read(1).astype(np.float64), source.bounds, source.transform
    with rasterio.open(survey / "out" / "intensity.tif") as source:
        window = source.window(*bounds).round_offsets().round_lengths()
        found = source.read(1, window=window).astype(np.float64)
    y, x = np.mgrid[: truth.shape[0], : truth.shape[1]] + 0.5
    outlines = json.loads((survey / "truth" / "scene.json").read_text())["building_outlines"]
    means = []
    for ring in outlines:
        roof = shapely.Polygon(ring).buffer(-1.5)
        inner = shapely.contains_xy(roof, at.c + x, at.f - y) & (found > -9000)
        means.append((found[inner].mean(), truth[inner].mean()))
    assert len(means) == len(ROOFS)
    mean, true = np.array(means).T
    assert 1 - ((mean - true) ** 2).sum() / ((true - true.mean()) ** 2).sum() >= 0.95
    assert 0.95 < np.median(mean / true) < 1.05
