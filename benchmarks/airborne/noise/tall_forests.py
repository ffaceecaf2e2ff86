"""What the rules for air that tapers take of forests with high crowns.

Run ``python -m benchmarks.airborne.noise.tall_forests [FOLDER]``.

Crowns on long trunks hang above clear air as a cloud does. Each row is a survey of 110 m with
forest alone. It prints the share of the vegetation [%] in cubes that hold air: by all rules; with
``CLEAR`` beyond reach, so that three layers have to be steady everywhere; and with ``ALIKE`` of
100, so that columns may hold any number of pairs.
"""

import argparse
import tempfile
from pathlib import Path
from typing import Any
from unittest import mock

import laspy
import numpy as np
import pyarrow.parquet as pq
from numpy.typing import NDArray

from benchmarks.airborne.sky import BASE
from spl_batch.airborne.noise import haze
from spl_batch.airborne.simulate import simulate
from spl_batch.airborne.simulate.scene.scene_file import parse_scene
from spl_batch.airborne.simulate.survey import KINDS
from spl_batch.lattice.tiles import quanta

NOISE: float = BASE["sky"]["background_per_m3"]

FORESTS: tuple[dict[str, Any], ...] = tuple(
    {"cover": cover, "height_m": height, "crown_share": crown, "radius_m": radius,
     "extinction_per_m": extinction, "gaps": gaps}
    for cover, height, crown, radius, extinction, gaps in (
        (0.85, (38, 44), 0.35, (3, 6), 0.35, 0.15),
        (0.89, (38, 44), 0.35, (3, 6), 0.1, 0.0),
        (0.6, (38, 46), 0.4, (3, 6), 0.2, 0.1),
        (0.3, (40, 48), 0.35, (4, 8), 0.15, 0.15),
        (0.89, (40, 40.1), 0.35, (6, 10), 0.08, 0.0),
        (0.89, (44, 52), 0.35, (4, 8), 0.1, 0.0),
        (0.89, (45, 46), 0.3, (8, 12), 0.06, 0.0),
        (0.89, (45, 50), 0.3, (6, 10), 0.1, 0.0),
        (0.89, (48, 56), 0.4, (4, 7), 0.06, 0.1),
        (0.89, (28, 30), 0.6, (6, 10), 0.06, 0.0),
    )
)  # fmt: skip
"""Closed and open ones, of crowns that are evenly turbid."""


def main() -> None:
    """Simulate, look and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", type=Path)
    folder = parser.parse_args().folder or Path(tempfile.mkdtemp())
    print(f"{'':62s}{'all rules':>12s}{'no CLEAR':>12s}{'no ALIKE':>12s}")
    for number, trees in enumerate(FORESTS):
        scene = BASE | {"name": "forest", "buildings": {"count": 0}, "wires": [], "trees": trees}
        title = ", ".join(str(value) for value in trees.values())
        _print(title, folder / f"forest_{number}", scene)


def _print(title: str, folder: Path, scene: dict[str, Any]) -> None:
    if not folder.exists():
        simulate(parse_scene(scene, "scene"), folder)
    xyz, kind = _points(folder)
    counted = kind != KINDS.index("afterpulse")
    axes = (xyz[:, 0].copy(), xyz[:, 1].copy(), xyz[:, 2].copy())
    counts = haze.count_cubes(axes, counted)
    assert counts is not None
    shares = []
    for name, value in (("CLEAR", haze.CLEAR), ("CLEAR", 10**6), ("ALIKE", 100.0)):
        with mock.patch.object(haze, name, value):
            air = haze.find_air(counts, lambda at: np.full(len(at[0]), NOISE))
        noise = haze.noise_with_air(axes, np.full(len(xyz), NOISE), air)
        shares.append(100 * float((noise[kind == KINDS.index("vegetation")] > NOISE).mean()))
    print(f"{title:62s}" + "".join(f"{share:12.2f}" for share in shares), flush=True)


def _points(folder: Path) -> tuple[NDArray[np.int64], NDArray[Any]]:
    """Coordinates [quanta] and kinds of all points."""
    xyz, kind = [], []
    for path in sorted((folder / "flightlines").glob("*.la[sz]")):
        las = laspy.read(path)
        xyz.append(np.rint(np.column_stack([las.x, las.y, las.z]) * quanta(1.0)).astype(np.int64))
        kind.append(pq.read_table(folder / "truth" / f"{path.stem}.parquet")["kind"].to_numpy())
    return np.concatenate(xyz), np.concatenate(kind)


if __name__ == "__main__":
    main()
