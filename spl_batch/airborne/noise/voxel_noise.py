"""Expected background per voxel: the voxel-spherical model.

Domain: time. Sources: [W17] Eq. 5.2-5.3, 6.1-6.2; [W18] Eq. 1-2.

| symbol | name |
|---|---|
| r | :func:`sphere_radius_m` |
| l_i | chord, :func:`~spl_batch.airborne.noise.voxel_chords.chord_length` |
| n_u, n | ``VoxelPart.shots``, ``VoxelPart.beamlets`` |

Deviations: points hold no silent beamlets, and the published gamma counts a shot that merely
touches the sphere as a whole one. By default the seen beamlets of a few shots share out equally
what these shots listened to. A beamlet counts once, however many returns it has; chords end at the
gate. Where channels are unknown, each return is a beamlet of its shot. The published correction
leaves out the gain of the ground.
"""

from collections.abc import Iterable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.beams.rays import in_voxels, reach
from spl_batch.airborne.beams.shot_runs import run_starts, share_out
from spl_batch.airborne.noise.line_model import LineModel
from spl_batch.airborne.noise.line_noise import gate_of, line_density
from spl_batch.airborne.noise.voxel_chords import MOST, deposit_beamlets
from spl_batch.airborne.settings import NoiseSettings
from spl_batch.constants import QUANTUM_M
from spl_batch.lattice.tables import FIXED_POINT, BeamTable, PointTable, VoxelPart
from spl_batch.lattice.tiles import far_apart, quanta

FAR_Q: Final = 1_000_000
"""Empty columns or rows of more than this divide a stretch's voxels into boxes [quanta]."""

BEAMLET: Final = 16
"""What a beamlet over ground of gain 1 adds to the counts of squares. Half and twice move 29 + 0
and 11 + 0 labels."""

COLUMNS_NEEDED: Final = ("x", "y", "z", "gps_time", "channel", "shot")


def sphere_radius_m(voxel_m: float) -> float:
    """Radius of the sphere with the volume of a voxel [m]: 6.2035 m for 10 m."""
    return voxel_m * float(np.cbrt(3.0 / (4.0 * np.pi)))


def deposit(
    table: PointTable,
    beams: BeamTable,
    model: LineModel,
    settings: NoiseSettings,
    ground: NDArray[np.float64] | None = None,
) -> list[VoxelPart]:
    """A stretch's share of the noise expected in each voxel, a box of voxels for each place of it.

    A single stray point would stretch one box over all that lies between.

    Parameters
    ----------
    table : PointTable
        Rows of one stretch, sorted by (gps_time, channel, ...).
    beams : BeamTable
        Their beams; rows without a known beam deposit nothing.
    ground : (n,) float64, optional
        Gain of the ground that each point's beamlet looks at; 1 by default.

    Returns
    -------
    list of VoxelPart
        From west to east and south to north, with ``shots`` and ``beamlets`` where the correction
        is "published", else with ``squares``; none where no beamlet is known.
    """
    published = settings.correction == "published"
    rows = np.flatnonzero(beams.known)
    if model.beamlets > 1:
        rows = rows[run_starts(table["gps_time"][rows], table["channel"][rows])[:-1]]
    near, far = gate_of(table.select(COLUMNS_NEEDED).take(rows), beams.take(rows), model)
    usable = far > near
    rows, near, far = rows[usable], near[usable], far[usable]
    table, beams = table.select(COLUMNS_NEEDED).take(rows), beams.take(rows)
    near, far = near - beams.range_m, far - beams.range_m
    if len(table) == 0:
        return []
    ground = np.ones(len(table)) if ground is None else ground[rows]
    per_m = line_density(table, model) if published else seen_density(table, model) * ground
    share = np.clip(np.rint(BEAMLET * ground), 1, MOST).astype(np.int64)
    boxes: Iterable[NDArray[np.intp] | slice] = [slice(None)]
    if any(np.ptp(table[axis]) > FAR_Q for axis in "xy"):
        boxes = map(np.sort, far_apart(np.column_stack((table["x"], table["y"])), FAR_Q))
    return [
        _in_one_box(
            table.take(own), beams.take(own), near[own], far[own], per_m[own], share[own], settings
        )
        for own in boxes
    ]


def _in_one_box(
    table: PointTable,
    beams: BeamTable,
    near: NDArray[np.float64],
    far: NDArray[np.float64],
    per_m: NDArray[np.float64],
    share: NDArray[np.int64],
    settings: NoiseSettings,
) -> VoxelPart:
    """What beamlets deposit in the voxels around all of them.

    ``near``, ``far``: ends of the gate along each beamlet, from its point [m]; ``per_m``: its noise
    [1/m]; ``share``: what it adds to the squares' counts.
    """
    published = settings.correction == "published"
    edge = quanta(settings.voxel_m)
    place = (table["x"], table["y"], table["z"])
    direction = beams.direction
    radius = sphere_radius_m(settings.voxel_m)
    corner, shape = _box(*reach(place, QUANTUM_M, direction, near, far), settings.voxel_m)
    voxel, relative = np.empty((len(table), 3), np.int64), np.empty((len(table), 3))
    in_voxels(place, edge, corner, 0.5 * QUANTUM_M, voxel, relative)
    amount = np.zeros(shape, dtype=np.int64)
    counted = np.zeros((2, *(shape if published else (0, 0, 0))), dtype=np.int64)
    squares = np.zeros((0, 0, 0, 16) if published else (*shape, 16), dtype=np.uint16)
    shot = table["shot"]
    if published:
        shot = np.cumsum(np.diff(table["gps_time"], prepend=-np.inf) != 0)
    deposit_beamlets(
        voxel, relative, direction, near, far,
        per_m.astype(np.float64) * FIXED_POINT, settings.voxel_m, radius, shot,
        amount, counted[0], counted[1], share, squares,
    )  # fmt: skip
    first = (int(corner[0]), int(corner[1]), int(corner[2]))
    if published:
        return VoxelPart(first, amount, counted[0], counted[1])
    return VoxelPart(first, amount, squares=squares)


def seen_density(table: PointTable, model: LineModel) -> NDArray[np.float64]:
    """Noise that each seen beamlet stands for, silent ones included: (n,) float64 [1/m].

    Mean rate times beamlets fired over beamlets seen, within ``model.seen_shots`` shots. ``table``:
    a row for each seen beamlet, in time order.
    """
    shot = table["shot"]
    row = model.row(shot)
    fired, seen = share_out(
        shot, table["gps_time"], model.seen_shots, model.interval_shots, row,
        model.first, model.last,
    )  # fmt: skip
    fired *= model.beamlets
    density: NDArray[np.float64] = model.rate.take(row)
    density *= fired
    density /= seen
    return density


def _box(
    low: NDArray[np.float64], high: NDArray[np.float64], voxel_m: float
) -> tuple[NDArray[np.int64], tuple[int, int, int]]:
    """Voxels that beamlets within a box can touch: first index and number along each axis."""
    radius = sphere_radius_m(voxel_m)
    # One voxel more on each side, for candidates that are yet to be measured.
    corner = np.floor((low - 2 * radius) / voxel_m).astype(np.int64) - 1
    stop = np.floor((high + 2 * radius) / voxel_m).astype(np.int64) + 2
    size = stop - corner
    return corner, (int(size[0]), int(size[1]), int(size[2]))


def density(
    amount: NDArray[np.int64],
    settings: NoiseSettings,
    *,
    shots: NDArray[np.int64] | None = None,
    beamlets: NDArray[np.int64] | None = None,
    beamlets_per_shot: int = 100,
) -> NDArray[np.float64]:
    """Expected noise density of voxels from the sum of all parts [W18 Eq. 2].

    Parameters
    ----------
    amount : ndarray of int64
        Sum of ``VoxelPart.amount`` over all stretches of all flightlines.
    shots, beamlets : ndarray of int64, optional
        Sums of the other two; needed where the correction is "published".
    beamlets_per_shot : int
        The 100 of gamma = 100 n_u / n.

    Returns
    -------
    ndarray of float64
        Noise points per cubic metre, shaped like ``amount``.

    Raises
    ------
    ValueError
        If the published correction lacks its sums.
    """
    per_m3: NDArray[np.float64] = amount / (FIXED_POINT * settings.voxel_m**3)
    if settings.correction == "seen":
        return per_m3
    if shots is None or beamlets is None:
        raise ValueError("the published correction needs the sums of shots and of beamlets")
    gamma = beamlets_per_shot * shots / np.maximum(beamlets, 1)
    return per_m3 * gamma
