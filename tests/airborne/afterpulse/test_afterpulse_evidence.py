"""What is found under roofs, ground and water, in small surveys with truth."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pyarrow.parquet as pq
import shapely
from numpy.typing import NDArray

from spl_batch import Labels, filter_points
from spl_batch.airborne.simulate import simulate
from spl_batch.airborne.simulate.scene.ray_trace import KINDS
from spl_batch.airborne.simulate.scene.scene_file import parse_scene
from spl_batch.constants import NOISE_AFTERPULSE, NOISE_SIGNAL

GROUND, ROOF, AFTERPULSE, BOTTOM = map(KINDS.index, ("ground", "roof", "afterpulse", "bottom"))
SCENE: dict[str, Any] = {
    "name": "hard", "seed": 3, "extent_m": [36, 36], "terrain": {"relief_m": 2},
    "buildings": {"list": [{"centre_m": [12, 18], "size_m": [18, 14], "roof": "gable"},
                           {"centre_m": [28, 10], "size_m": [10, 10], "roof": "flat"}]},
    "flights": [{"heading_deg": 0, "offset_m": 300, "speed_m_s": 110},
                {"heading_deg": 90, "offset_m": -280, "speed_m_s": 110},
                {"heading_deg": 200, "offset_m": 350, "speed_m_s": 110, "sky": 1.3}],
    "sky": {"background_per_m3": 0.08},
    "acquisition": {"prf_hz": 30_000, "gate_m": 150},
}  # fmt: skip
LAKE = {"ring_m": [[6, 6], [31, 7], [30, 31], [7, 30]], "depth_m": 1.2, "reflectance": 0.15,
        "bottom_reflectance": 0.1}  # fmt: skip

Columns = dict[str, NDArray[Any]]


def filtered(folder: Path, *, polygons: bool = True, **parts: Any) -> tuple[Labels, Columns]:
    """Labels of a simulated survey, and the truth: kind, parent, lag [m]."""
    scene = parse_scene(SCENE | parts, "hard")
    simulate(scene, folder)
    flown = np.loadtxt(folder / "trajectory.csv", delimiter=",", skiprows=1)
    columns: dict[str, list[NDArray[Any]]] = {}
    for line, path in enumerate(sorted((folder / "flightlines").glob("*.laz"))):
        las = laspy.read(path)
        truth = pq.read_table(folder / "truth" / f"{path.stem}.parquet")
        xyz, time = np.asarray(las.xyz), np.asarray(las.gps_time)
        parent = truth["parent_row"].to_numpy()
        part = {
            "xyz": xyz, "gps_time": time, "channel": np.asarray(las["channel"]),
            "return_number": np.asarray(las.return_number), "flightline": np.full(len(xyz), line),
            "beam_origin": np.column_stack(
                [np.interp(time, flown[:, 0], flown[:, k]) for k in (1, 2, 3)]),
            "kind": truth["kind"].to_numpy(), "parent": truth["parent"].to_numpy(),
            "lag": np.where(parent >= 0, np.linalg.norm(xyz - xyz[parent], axis=1), 0.0),
        }  # fmt: skip
        for name, values in part.items():
            columns.setdefault(name, []).append(values)
    table = {name: np.concatenate(values) for name, values in columns.items()}
    truth_of = {name: table.pop(name) for name in ("kind", "parent", "lag")}
    rings = [np.array(water.ring_m) + scene.origin_m[:2] for water in scene.water]
    x, y = table["xyz"][:, 0], table["xyz"][:, 1]
    if polygons and rings:
        table["water"] = np.any([shapely.contains_xy(shapely.Polygon(r), x, y) for r in rings], 0)
    return filter_points(**table, settings={"acquisition": SCENE["acquisition"]}), truth_of


def of(truth: Mapping[str, NDArray[Any]], parent: int) -> NDArray[np.bool_]:
    """Afterpulses of a kind of surface."""
    found: NDArray[np.bool_] = (truth["kind"] == AFTERPULSE) & (truth["parent"] == parent)
    return found


def test_afterpulses_of_hard_surfaces_are_found_and_the_surfaces_stay(tmp_path: Path) -> None:
    labels, truth = filtered(tmp_path)
    called = labels.noise_class == NOISE_AFTERPULSE
    for parent in (ROOF, GROUND):
        mine = of(truth, parent)
        assert mine.sum() > 1000
        assert called[mine].mean() >= 0.97
        assert called[truth["kind"] == parent].mean() <= 0.001


def test_true_bottoms_of_clear_water_stay(tmp_path: Path) -> None:
    # A true bottom has an afterpulse's signature: a return of its beamlet a short way in front.
    labels, truth = filtered(tmp_path, polygons=False, seed=6, buildings={}, water=[LAKE])
    kept = labels.noise_class == NOISE_SIGNAL
    assert (truth["kind"] == BOTTOM).sum() > 500
    assert kept[truth["kind"] == BOTTOM].mean() >= 0.95
    assert kept[truth["kind"] == GROUND].mean() >= 0.995
    assert kept[of(truth, GROUND)].mean() <= 0.03


def test_lags_that_the_sensor_does_not_state_are_followed(tmp_path: Path) -> None:
    tail = {"share": 1.0, "scale_m": 0.5, "power": 1.5}
    detector = {"afterpulse_probability": 0.25, "afterpulse_lag_max_m": 15.0, "tail": tail}
    labels, truth = filtered(tmp_path, detector=detector)
    called, mine = labels.noise_class == NOISE_AFTERPULSE, of(truth, GROUND)
    late = mine & (truth["lag"] > 5.0)
    assert late.sum() > 100
    assert (labels.noise_class[mine] != NOISE_SIGNAL).mean() >= 0.95
    assert (labels.noise_class[late] != NOISE_SIGNAL).mean() >= 0.9
    assert called[truth["kind"] == GROUND].mean() <= 0.001
