"""Checkpoints of a field survey of the scene: true heights of its ground, with a field's error."""

from pathlib import Path
from typing import Final

import numpy as np
import shapely
from numpy.typing import NDArray

from spl_batch.airborne.simulate.linear_mode import surface_heights
from spl_batch.airborne.simulate.scene.layout import Layout, footprints
from spl_batch.airborne.simulate.scene.ray_trace import SceneArrays
from spl_batch.airborne.simulate.scene.scene_file import Scene
from spl_batch.formats.files.atomic import write_bytes

WANTED: Final = {"open": 40, "vegetated": 32}
"""Checkpoints of each kind, as far as the scene has room [count]."""

CANDIDATES: Final = 4000
"""Places that are looked at [count]."""

ACCURACY_M: Final = 0.015
"""Vertical accuracy of the field survey, one sigma [m]."""

OPEN_M: Final = 0.05
"""What stands on open ground is no higher [m]."""

CROWN_M: Final = 2.0
"""What stands on vegetated ground is no lower [m]."""

INSIDE_M: Final = 5.0
"""Distance to the scene's edge, to water and to houses, at the least [m]."""


def write_checkpoints(scene: Scene, arrays: SceneArrays, layout: Layout, path: Path) -> None:
    """Write ``id,x,y,z,surface,accuracy_m``: open ground, and ground below crowns.

    Parameters
    ----------
    scene : Scene
        The scene.
    arrays, layout
        What it became.
    path : Path
        File.
    """
    rng = np.random.default_rng(np.random.SeedSequence(scene.seed, spawn_key=(8,)))
    size = np.array(scene.extent_m)
    xy = INSIDE_M + rng.random((CANDIDATES, 2)) * np.maximum(size - 2 * INSIDE_M, 0.0)
    error_m = ACCURACY_M * rng.standard_normal(CANDIDATES)
    ground, surface = np.empty((2, CANDIDATES))
    surface_heights(arrays, xy[:, 0].copy(), xy[:, 1].copy(), ground, surface)
    free = ~_built(scene, layout, xy)
    kinds = {"open": surface - ground <= OPEN_M, "vegetated": surface - ground >= CROWN_M}
    lines = ["id,x,y,z,surface,accuracy_m"]
    for name, there in kinds.items():
        for number, k in enumerate(np.flatnonzero(free & there)[: WANTED[name]], start=1):
            x, y = xy[k] + scene.origin_m[:2]
            z = ground[k] + error_m[k]
            lines.append(
                f"{name[0].upper()}{number:02d},{x:.3f},{y:.3f},{z:.3f},{name},{ACCURACY_M}"
            )
    write_bytes(path, ("\n".join(lines) + "\n").encode())


def _built(scene: Scene, layout: Layout, xy: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Places in or beside houses and water."""
    shapes = [*footprints(layout.buildings), *(shapely.Polygon(w.ring_m) for w in scene.water)]
    if not shapes:
        return np.zeros(len(xy), np.bool_)
    taken = shapely.union_all(shapes).buffer(INSIDE_M)
    found: NDArray[np.bool_] = shapely.contains_xy(taken, xy[:, 0], xy[:, 1])
    return found
