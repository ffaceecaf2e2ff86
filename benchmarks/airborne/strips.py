"""How far flightlines are found to lie apart, against shifts that are known.

Run ``python -m benchmarks.airborne.strips``.

Three flightlines over hills, houses and trees; the second one's returns are recorded off by each
shift in turn. Printed is where it is found to lie against the first, and what part of the tasks'
time the patches take.
"""

import tempfile
from pathlib import Path
from typing import Any, Final

from spl_batch import api
from spl_batch.airborne.simulate import simulate
from spl_batch.airborne.simulate.scene.scene_file import parse_scene
from spl_batch.engine.store.working_store import Store, read_receipts

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


def main() -> None:
    """Print a row for each shift."""
    print("scene", SCENE)
    print("shift [cm] | found: east, north, up +- | noise | time")
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


def _row(shift: tuple[float, float, float], folder: Path) -> None:
    workflow = survey(shift, folder)
    result = api.run(workflow, workers=0)
    kept = next(p for p in result.report.strips if p.second.startswith("00002"))
    parts = [
        " ".join(f"{100 * v:6.1f}" for v in shift),
        " ".join(_cm(v) for v in (kept.east_m, kept.north_m, kept.up_m, kept.up_sd_m)),
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


if __name__ == "__main__":
    main()
