"""Looks of the pixels, points in the local frame [G15 3.5], and rays into the water [G15 2.5.2].

Frames: the sensor's has z along the optical axis; the local one is north, east, down. Normals point
out of the water.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from spl_batch.constants import SPEED_OF_LIGHT_M_S
from spl_batch.geiger.water.settings import CameraSettings, MountSettings

Floats = NDArray[np.float64]

HALF_C_M_NS: Final = SPEED_OF_LIGHT_M_S * 1e-9 / 2
"""Range for each nanosecond of a two-way time [m/ns]."""


@dataclass(frozen=True, slots=True)
class View:
    """Where each pixel looks."""

    #: (rows, cols): image coordinates over the focal length [G15 Eq. 3-11].
    x: Floats
    y: Floats
    rotation: Floats  #: (3, 3): from the sensor's frame to the local one.
    origin_m: Floats  #: (3,): lens in the local frame: north, east, down [m].

    @property
    def norm(self) -> Floats:
        """Length of (x, y, 1) [G15 Eq. 3-12]: (rows, cols) float64."""
        return np.asarray(np.sqrt(self.x**2 + self.y**2 + 1.0))

    @property
    def look(self) -> Floats:
        """Unit vectors in the local frame [G15 Eq. 3-13 to 3-15]: (rows, cols, 3) float64."""
        vectors = np.stack([self.x, self.y, np.ones_like(self.x)], axis=-1)
        return np.asarray((vectors / self.norm[..., None]) @ self.rotation.T)

    def points(self, range_m: Floats) -> Floats:
        """North, east, down of ranges: (..., rows, cols, 3) float64 [m]."""
        return np.asarray(self.origin_m + range_m[..., None] * self.look)


def rotation(roll_deg: float, pitch_deg: float, heading_deg: float) -> Floats:
    """Rz(heading) Ry(pitch) Rx(roll): (3, 3) float64 [G15 Eq. 3-6]."""
    angles = [heading_deg, pitch_deg, roll_deg]
    return np.asarray(Rotation.from_euler("ZYX", angles, degrees=True).as_matrix())


def view_of(camera: CameraSettings, mount: MountSettings) -> View:
    """Look-up vectors, boresight, lever arms and position put together [G15 Eq. 3-6 to 3-11]."""
    step = camera.pitch_mm / camera.focal_mm
    row, col = np.mgrid[0 : camera.rows, 0 : camera.cols].astype(np.float64)
    body = rotation(*mount.attitude_deg)
    sensor = rotation(0.0, mount.off_nadir_deg, mount.scan_deg)
    return View(
        step * ((camera.rows - 1) / 2 - row),
        step * (col - (camera.cols - 1) / 2),
        body @ rotation(*mount.boresight_deg) @ sensor,
        np.array(mount.position_m) + body @ np.array(mount.lever_arm_m),
    )


def refracted(beam: Floats, normal: Floats, index_water: float) -> Floats:
    """Direction of a beam behind the surface [G15 Eq. 2-27]: (..., 3) float64, unit vectors.

    ``beam`` points towards the water, ``normal`` out of it; ``index_water``: that of air being 1.
    """
    eta = 1.0 / index_water
    k = -(beam * normal).sum(axis=-1, keepdims=True)
    root = np.sqrt(1.0 + eta**2 * (k**2 - 1.0))
    return np.asarray(eta * beam + (eta * k - root) * normal)


def floor_points(surface: Floats, direction: Floats, in_water_m: float | Floats) -> Floats:
    """Where rays end after a path in water: (..., 3) float64 [m]."""
    return np.asarray(surface + np.asarray(in_water_m)[..., None] * direction)
