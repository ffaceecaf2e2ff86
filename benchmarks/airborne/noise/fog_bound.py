"""What the filter could do about ground fog if the fog were known exactly.

Run ``python -m benchmarks.airborne.noise.fog_bound [FOLDER] [--scales 0.75 1.5 3]``.

Each scene of :mod:`benchmarks.airborne.sky` in fog of 60 times the noise is run three times: as it
is; with the fog's true density at each place added to the expected noise, which no estimate from
the points can beat; and with that from 1 m above the ground on, so that the ground is not held to
it. What these runs keep bounds any rule that feeds fog to the test.
"""

import argparse
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final
from unittest.mock import patch

import numpy as np
import rasterio
from numpy.typing import NDArray
from scipy import ndimage

from benchmarks.airborne.sky import BASE, scene
from benchmarks.airborne.sky_figures import measure
from spl_batch.airborne.filter.air import noise_in_air
from spl_batch.airborne.filter.expected_noise import Expected
from spl_batch.airborne.simulate import simulate
from spl_batch.airborne.simulate.haze import FOG_DEPTH
from spl_batch.airborne.simulate.scene.scene_file import parse_scene
from spl_batch.airborne.tasks import space_domain
from spl_batch.constants import QUANTUM_M
from spl_batch.engine.verbs.running import run
from spl_batch.lattice.tables import PointTable

TIMES: Final = 60.0
"""Fog at the ground over the noise."""

SHOWN: Final = ("noise removed", "far noise kept", "ground", "roof", "vegetation", "wire",
                "DSM > 1 m")  # fmt: skip
"""Figures of :func:`benchmarks.airborne.sky_figures.measure` that are printed [%]."""


def known_fog(survey: Path, scale_m: float, low_m: float) -> Callable[..., Expected]:
    """Expected noise with the true density of the fog in it, from a height above the ground on."""
    with rasterio.open(survey / "truth" / "dtm.tif") as source:
        dtm, origin = source.read(1).astype(np.float64), source.transform
    missing = dtm < -9000
    near = ndimage.distance_transform_edt(missing, return_distances=False, return_indices=True)
    dtm = dtm[tuple(near)]
    at_ground = TIMES * BASE["sky"]["background_per_m3"]

    def fog(table: PointTable) -> NDArray[np.float64]:
        x, y, z = (table[axis] * QUANTUM_M for axis in "xyz")
        place = [(origin.f - y) / -origin.e - 0.5, (x - origin.c) / origin.a - 0.5]
        height = z - ndimage.map_coordinates(dtm, place, order=1, mode="nearest")
        held = (height > low_m) & (height < FOG_DEPTH * scale_m)
        return np.where(held, at_ground * np.exp(-np.maximum(height, 0.0) / scale_m), 0.0)

    def expected(table: PointTable, told: NDArray[np.bool_], *given: Any) -> Expected:
        found = noise_in_air(table, told, *given)
        return Expected(found.mean + fog(table)[told], found.local + fog(table))

    return expected


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--scales", nargs="+", type=float, default=[0.75, 1.5, 3.0])
    given = parser.parse_args()
    print(f"{'scale [m]':10s}{'fog':10s}" + "".join(f"{name:>16s}" for name in SHOWN))
    with tempfile.TemporaryDirectory() as temporary:
        for scale_m in given.scales:
            survey = (given.folder or Path(temporary)) / f"fog_{scale_m:g}"
            if not (survey / "workflow.yaml").exists():
                content = scene("base", 1.0)
                content["sky"] = {**content["sky"], "fog": [
                    {"times_noise": TIMES, "scale_m": scale_m}
                ]}  # fmt: skip
                simulate(parse_scene(content, "fog"), survey)
            for name, noise in (
                ("as it is", noise_in_air),
                ("known", known_fog(survey, scale_m, -0.2)),
                ("above 1 m", known_fog(survey, scale_m, 1.0)),
            ):
                with patch.object(space_domain, "noise_in_air", noise):
                    run(survey / "workflow.yaml", workers=0, fresh=True)
                found = measure(survey)
                row = "".join(f"{found[key]:16.2f}" for key in SHOWN)
                print(f"{scale_m:<10g}{name:10s}{row}", flush=True)


if __name__ == "__main__":
    main()
