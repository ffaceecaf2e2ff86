"""Which returns around a candidate its own flightline has: flightlines may lie apart.

Domain: space. Where one flightline lies higher than another, its afterpulses come to lie in the
surface of the lower one, whose returns look like a surface behind a hard one. A true surface there,
as the bottom of water, gives returns to both. Returns of one flightline at one place are seconds
apart, as the scan looks ahead and back; those of another come minutes later.
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.afterpulse.weighted_counts import UNIT, Columns
from spl_batch.numerics.compiled import njit
from spl_batch.numerics.neighbours.kdtree import U0, U1, U2
from spl_batch.numerics.neighbours.lattice_columns import first_above

PASS_S: Final = 40.0
"""Returns of one place no further apart are of one flightline [s]."""

CHANCE: Final = 2.0
"""Factor to the own flightline's returns, over its share of the returns around, that chance may
explain."""


@njit()
def weigh_own(
    xyz: NDArray[np.int32], time: NDArray[np.float64], channel: NDArray[np.uint8],
    weight: NDArray[np.int16], starts: NDArray[np.int64], shape: tuple[int, int], edge: int,
    rows: NDArray[np.int32], radii: NDArray[np.int64], tilt: NDArray[np.float64], within_s: float,
    out: NDArray[np.int64],
) -> None:  # fmt: skip
    """Kernel sums of other beamlets' weights around points, and of those of their flightline.

    Parameters
    ----------
    xyz, time, channel, weight, starts, shape, edge, rows, radii, tilt
        As in :func:`~spl_batch.airborne.afterpulse.weighted_counts.weigh_around`.
    within_s : float
        Longest time between returns of one flightline at one place [s].
    out : (m, k, 2) int64
        Filled by point and kernel: all, and those of the point's flightline.
    """
    nx, ny = shape
    across, up = 1.0 / radii[:, 0].astype(np.float64) ** 2, 1.0 / radii[:, 1] ** 2.0
    for q in range(len(rows)):
        row, bx, by = rows[q], tilt[q, 0], tilt[q, 1]
        x, y, z = xyz[U0, row], xyz[U1, row], xyz[U2, row]
        span = radii[0, 1] + np.int64(np.ceil(np.hypot(bx, by) * radii[0, 0]))
        out[q] = 0
        for i in range(max(x // edge - 1, 0), min(x // edge + 2, nx)):
            for j in range(max(y // edge - 1, 0), min(y // edge + 2, ny)):
                low, stop = starts[i * ny + j], starts[i * ny + j + 1]
                for p in range(first_above(xyz, low, stop, z - span), stop):
                    if xyz[U2, p] > z + span:
                        break
                    if time[p] == time[row] and channel[p] == channel[row]:
                        continue
                    dx, dy = np.float64(xyz[U0, p] - x), np.float64(xyz[U1, p] - y)
                    flat = dx * dx + dy * dy
                    square = (np.float64(xyz[U2, p] - z) - bx * dx - by * dy) ** 2
                    own = abs(time[p] - time[row]) <= within_s
                    for k in range(len(radii)):
                        left = max(1.0 - flat * across[k] - square * up[k], 0.0)
                        worth = np.int64(weight[p]) * np.int64(left * left * UNIT)
                        out[q, k, 0] += worth
                        out[q, k, 1] += worth * own


def supported(
    points: tuple[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any]], listed: Columns,
    places: NDArray[np.int32], flat: tuple[int, int], tilt: NDArray[np.float64],
) -> NDArray[np.float64]:  # fmt: skip
    """Returns in flat ellipsoids, as far as the own flightline has its share of them.

    Parameters
    ----------
    points : (3, n) int32, (n,) float64, (n,) uint8, (n,) int16
        ``xyz``, ``time``, ``channel`` and ``weight`` of :func:`weigh_own`.
    listed, places, tilt
        Columns, and the points to count around, as there.
    flat : (int, int)
        Horizontal and vertical radius [quanta]; the ball around the ellipsoid tells the share.

    Returns
    -------
    (m,) float64
        [returns x :data:`UNIT` ** 2].
    """
    radii = np.array([[flat[0], flat[0]], flat], dtype=np.int64)
    sums = np.empty((len(places), 2, 2), dtype=np.int64)
    weigh_own(*points, listed.starts, listed.shape, listed.edge, places, radii, tilt, PASS_S, sums)
    return bounded(sums)


def bounded(sums: NDArray[np.int64]) -> NDArray[np.float64]:
    """Second kernel's sums, by the own flightline's share in the first: (m,) float64."""
    (everything, flat), (own, own_flat) = (sums[:, :, k].T.astype(np.float64) for k in (0, 1))
    told = CHANCE * own_flat * everything / np.maximum(own, 1.0)
    found: NDArray[np.float64] = np.where(own > 0, np.minimum(flat, told), flat)
    return found
