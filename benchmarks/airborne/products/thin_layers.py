"""How evenly thin haze and crowns fill the air.

Run ``python -m benchmarks.airborne.products.thin_layers [FOLDER]``.

Scenes of 110 m with haze of 6 m in patches, at 10, 20 and 40 times the noise, and forests of
several kinds without haze, each with several seeds; ``--half`` leaves out half of all returns. From
the simulated returns and the true terrain come (``--afterpulses``: with all afterpulses, else
none), by the rule of :mod:`spl_batch.airborne.products.air.thin_haze`,

- the clumping of blocks that hold enough, its 5th, 25th and 50th percentile;
- the share of them that are even enough, of all that hold enough, and the same of the emptier half
  of their columns [%];
- places of the largest layer [count], and whether it is told;
- of scenes without haze, places that hold a thin sheet by the rule of
  :mod:`spl_batch.airborne.products.air.thin_sheets`, from all returns but noise [count].
"""

import argparse
import tempfile
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import laspy
import numpy as np
import pyarrow.parquet as pq
import rasterio
from numpy.typing import NDArray

from benchmarks.airborne.filter.methods import KINDS
from benchmarks.airborne.sky import BASE, haze
from spl_batch.airborne.products.air import near_ground, thin_haze, thin_sheets
from spl_batch.airborne.simulate import simulate
from spl_batch.airborne.simulate.scene.scene_file import parse_scene
from spl_batch.constants import NODATA, QUANTUM_M
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds, quanta

NOISE_M3: Final = float(BASE["sky"]["background_per_m3"])

LEVEL: Final = {"cover": 0.88, "radius_m": [3, 6], "understory": 0}
LOW: Final = {"height_m": [8, 16], "radius_m": [2, 6], "understory": 0.6}
SCENES: Final[Mapping[str, Mapping[str, Any]]] = MappingProxyType({
    "haze at 8-14 m, 10 x": haze(10, 8, 14),
    "haze at 8-14 m, 20 x": haze(20, 8, 14),
    "haze at 8-14 m, 40 x": haze(40, 8, 14),
    "trees, 25 %": {},
    "trees, 60 %": {"trees": {"cover": 0.6}},
    "trees, 85 %": {"trees": {"cover": 0.85}},
    "low trees, 85 %": {"trees": {"cover": 0.85, **LOW}},
    "large crowns, 88 %": {
        "trees": {"cover": 0.88, "height_m": [15, 30], "radius_m": [5, 9], "understory": 0.8}
    },
    "dense trees of 5-9 m, 88 %": {
        "trees": {"cover": 0.88, "height_m": [5, 9], "radius_m": [3, 5], "understory": 0.2}
    },
    "level crowns 3.5 m deep, 88 %": {
        "trees": {**LEVEL, "height_m": [14, 15], "crown_share": 0.25}
    },
    "level crowns 2 m deep, 88 %": {
        "trees": {**LEVEL, "height_m": [20, 20.5], "crown_share": 0.1}
    },
    "16 lines of 4 wires": {"trees": {"cover": 0.0}, "wires": [
        {"kind": "transmission", "points_m": [[-60, 5 + 6 * k], [170, 5 + 6 * k]], "height_m": 24,
         "sag_m": 2, "spacing_m": 2.0, "returns_per_m": 1.5}
        for k in range(16)
    ]},
})  # fmt: skip
"""What scenes have beyond the base of :mod:`benchmarks.airborne.sky`."""


def returns(
    survey: Path, *, half: bool, followed: bool, noise: bool = True
) -> tuple[PointTable, NDArray[np.float32], Bounds]:
    """Returns of a survey, its true terrain, and its bounds [quanta].

    ``half``: leave out half; ``followed``: afterpulses among them; ``noise``: noise and haze.
    """
    with rasterio.open(survey / "truth" / "dtm.tif") as source:
        dtm = source.read(1).astype(np.float32)
        sides = source.bounds
    dtm[dtm == source.nodata] = NODATA
    parts = []
    for path in sorted((survey / "flightlines").glob("*.laz")):
        las = laspy.read(path)
        kind = pq.read_table(survey / "truth" / f"{path.stem}.parquet")["kind"].to_numpy()
        chosen = followed | (kind != KINDS.index("afterpulse"))
        chosen &= noise | (kind != KINDS.index("background"))
        xyz = np.column_stack([las.x, las.y, las.z])[chosen]
        parts.append(np.rint(xyz / QUANTUM_M).astype(np.int64))
    places = np.concatenate(parts)
    if half:
        places = places[np.random.default_rng(1).random(len(places)) < 0.5]
    table = PointTable(
        {
            "x": places[:, 0],
            "y": places[:, 1],
            "z": places[:, 2].astype(np.int32),
            "noise_class": np.zeros(len(places), np.uint8),
        }
    )
    return table, dtm, Bounds(*(quanta(side) for side in sides))


def figures(survey: Path, *, half: bool, followed: bool) -> str:
    """What a survey shows; the arguments are those of :func:`returns`."""
    table, dtm, core = returns(survey, half=half, followed=followed)
    placed = near_ground.placed(table, core, near_ground.highest_ground(dtm))
    if placed is None:
        raise SystemExit(f"{survey}: no whole place")
    noise = NOISE_M3 * (0.5 if half else 1.0)
    blocks, emptier = thin_haze.clumping(placed, noise)
    enough = blocks[np.isfinite(blocks)]
    layers = thin_haze.layers(thin_haze.filled_blocks(placed, noise), core)
    places = max((round(layer[0]) for layer in layers), default=0)
    spread = "".join(f"{value:7.2f}" for value in np.percentile(enough, (5, 25, 50)))
    even = 100 * float(np.mean(enough <= thin_haze.EVEN))
    half = emptier[np.isfinite(emptier)]
    even_half = 100 * float(np.mean(half <= thin_haze.EVEN_EMPTIER)) if len(half) else 0.0
    return f"{spread}{even:9.2f}{even_half:9.2f}{places:8d}  {'told' if layers else '':4}"


def sheet_places(survey: Path, *, half: bool, followed: bool) -> int:
    """Places of a survey without haze that hold a sheet; arguments as of :func:`returns`."""
    table, dtm, core = returns(survey, half=half, followed=followed, noise=False)
    placed = near_ground.placed(table, core, near_ground.highest_ground(dtm))
    if placed is None:
        raise SystemExit(f"{survey}: no whole place")
    return int(np.count_nonzero(thin_sheets.sheets(placed).any(axis=2)))


def main() -> None:
    """Simulate, measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--seeds", nargs="+", type=int, default=[11, 12, 13])
    parser.add_argument("--half", action="store_true", help="leave out half of all returns")
    parser.add_argument("--afterpulses", action="store_true", help="keep all of them")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        titles = f"{'5 %':>7}{'25 %':>7}{'50 %':>7}{'even, %':>9}{'half, %':>9}{'places':>8}"
        print(f"{'':34}{titles}        sheets")
        for name, more in SCENES.items():
            for seed in given.seeds:
                survey = (given.folder or Path(temporary)) / f"{name}_{seed}".replace(" ", "_")
                if not (survey / "workflow.yaml").exists():
                    content = {**BASE, "name": name, "seed": seed}
                    for key, value in more.items():
                        content[key] = {**BASE[key], **value} if isinstance(value, dict) else value
                    simulate(parse_scene(content, name), survey)
                found = figures(survey, half=given.half, followed=given.afterpulses)
                if "haze" not in name:
                    places = sheet_places(survey, half=given.half, followed=given.afterpulses)
                    found += f"{places:6d}"
                print(f"{name:30}{seed:4}{found}", flush=True)


if __name__ == "__main__":
    main()
