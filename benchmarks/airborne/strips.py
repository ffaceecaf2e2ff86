"""How far flightlines are found to lie apart, against shifts that are known.

Run ``python -m benchmarks.airborne.strips``.

Three flightlines over hills, houses and trees; the second one's returns are recorded off by each
shift in turn. Printed is where it is found to lie against the first, from what the noise filter
keeps and from the truth's returns alone, and what part of the tasks' time the patches take.

``python -m benchmarks.airborne.strips align`` corrects them: the largest differences between
flightlines and the terrain's error against the reference with ``survey.align`` none, vertical and
rigid, of a survey that fits and one whose second flightline does not; and what part of the tasks'
time it takes to find the shifts.
"""

import sys
import tempfile
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow.parquet as pq

from spl_batch import api
from spl_batch.airborne.report.verdicts import terrain_statistics
from spl_batch.airborne.simulate import simulate
from spl_batch.airborne.simulate.scene.scene_file import parse_scene
from spl_batch.airborne.simulate.survey import KINDS
from spl_batch.airborne.strips.pair_table import Strip, named_passes, pair_table
from spl_batch.airborne.strips.strip_patches import find_passes, find_patches
from spl_batch.engine.store.working_store import Store, read_receipts
from spl_batch.formats.las.reader import iter_points
from spl_batch.lattice.tables import PointTable, concat
from spl_batch.lattice.tiles import Bounds
from spl_batch.receivers import steps

SHIFTS: Final = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.05), (0.3, -0.2, 0.2), (-0.4, 0.1, -0.1))
"""East, north and up of the second flightline [m]."""

SCENE: Final[dict[str, Any]] = {
    "extent_m": [120, 120],
    "seed": 11,
    "terrain": {"relief_m": 6, "wavelength_m": 70},
    "buildings": {"count": 5},
    "trees": {"cover": 0.15},
    "sky": {"background_per_m3": 0.02},
    "acquisition": {"prf_hz": 30_000, "gate_m": 100, "margin_m": 2},
}

NO_SURFACE: Final = ("background", "afterpulse", "bloom", "crosstalk")
"""Kinds of returns that no surface gave."""


OFF_M: Final = (0.3, 0.0, 0.2)
"""East, north and up of the second flightline where it is to be corrected [m]."""


def main() -> None:
    """Print a row for each shift."""
    print("scene", SCENE)
    if sys.argv[1:] == ["align"]:
        print(
            "shift [cm] | align | between flightlines: up, across | terrain: RMSE, mean, SD | time"
        )
        for shift in ((0.0, 0.0, 0.0), OFF_M):
            with tempfile.TemporaryDirectory() as folder:
                _corrected(shift, Path(folder))
        return
    print("shift [cm] | from what the filter keeps: east, north, up +- | from the truth | noise")
    for shift in SHIFTS:
        with tempfile.TemporaryDirectory() as folder:
            _row(shift, Path(folder))


def survey(shift: tuple[float, float, float], folder: Path) -> Path:
    """Workflow of three flightlines, the second one off by a shift."""
    flights = [
        {"heading_deg": 0, "speed_m_s": 100, "offset_m": 250},
        {"heading_deg": 90, "speed_m_s": 100, "offset_m": 150, "strip_offset_m": list(shift)},
        {"heading_deg": 200, "speed_m_s": 100, "offset_m": 300},
    ]
    return simulate(parse_scene({**SCENE, "flights": flights}, "scene"), folder).workflow


def _corrected(shift: tuple[float, float, float], folder: Path) -> None:
    workflow = survey(shift, folder)
    for how in ("none", "vertical", "rigid"):
        result = api.run(workflow, workers=0, fresh=True, overrides=[f"survey.align={how}"])
        pairs = result.report.strips
        up = max(abs(p.up_m) for p in pairs)
        across = [np.hypot(p.east_m, p.north_m) for p in pairs if p.east_m is not None]
        found = terrain_statistics(result.report)
        terrain = "-"
        if found is not None:
            name, of = found
            terrain = f"{name}: " + " ".join(_cm(v) for v in (of.rmse, of.mean, of.sd))
        receipts = [
            receipt
            for kind in steps("imaging")
            for receipt in read_receipts(Store(result.output), kind)
        ]
        aligning = sum(r.wall_s for r in receipts if r.kind in {"recorded_patches", "align"})
        parts = [
            " ".join(f"{100 * v:6.1f}" for v in shift),
            f"{how:8}",
            f"{100 * up:5.1f} {100 * max(across, default=np.nan):5.1f}",
            terrain,
            f"{100 * aligning / sum(r.wall_s for r in receipts):5.1f} %",
        ]
        print(" | ".join(parts), flush=True)
        for line in result.report.alignment.lines if result.report.alignment else ():
            moved = " ".join(_cm(v) for v in (line.east_m, line.north_m, line.up_m))
            errors = " ".join(_cm(v) for v in (line.horizontal_sd_m, line.up_sd_m))
            print(f"  {line.name}: {moved} +- {errors} {line.stays}", flush=True)


def _row(shift: tuple[float, float, float], folder: Path) -> None:
    workflow = survey(shift, folder)
    result = api.run(workflow, workers=0)
    kept = next(p for p in result.report.strips if p.second.startswith("00002"))
    true = _of_truth(folder)
    parts = [
        " ".join(f"{100 * v:6.1f}" for v in shift),
        " ".join(_cm(v) for v in (kept.east_m, kept.north_m, kept.up_m, kept.up_sd_m)),
        " ".join(_cm(v) for v in true),
        _cm(kept.noise_m),
    ]
    store = Store(result.output)
    spent = {
        kind: sum(r.wall_s for r in read_receipts(store, kind))
        for kind in ("gather", "scatter", "denoise", "ground", "surface", "strip_patches")
    }
    share = spent["strip_patches"] / sum(spent.values())
    print(" | ".join(parts), f"| patches take {100 * share:.1f} % of the tasks' time")


def _cm(metres: float | None) -> str:
    return "     -" if metres is None else f"{100 * metres:6.1f}"


def _of_truth(folder: Path) -> tuple[float | None, ...]:
    """East, north and up of the second flightline from the returns of surfaces alone."""
    names = ("x", "y", "z", "gps_time", "point_source_id")
    none = [KINDS.index(name) for name in NO_SURFACE]
    parts = []
    for path in sorted((folder / "flightlines").glob("*.laz"))[:2]:
        kind = pq.read_table(folder / "truth" / f"{path.stem}.parquet")["kind"].to_numpy()
        table = concat(list(iter_points(path, channel_dimension=None, source=0)), names)
        parts.append(table.take(~np.isin(kind, none)))
    points: PointTable = concat(parts, names)
    passes = find_passes([points], 60.0)
    strips = [Strip(f"{k}", k, 0.0, np.inf) for k in (1, 2)]
    west, south = (int(points[axis].min()) for axis in "xy")
    east, north = (int(points[axis].max()) + 1 for axis in "xy")
    patches = find_patches([points], passes, Bounds(west, south, east, north))
    names_of = named_passes(passes.psid, passes.time_s, strips)
    (pair,) = pair_table([(names_of, patches)])
    return pair.east_m, pair.north_m, pair.up_m


if __name__ == "__main__":
    main()
