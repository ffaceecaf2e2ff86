"""Expected background of the part of a voxel that is listened to, for testing points there.

Domain: space. A deviation from [W18] Eq. 2, whose density is the mean of a whole voxel. A
voxel that a gate's end, the edge of a flightline or of a delivery cuts is partly silent, and
its mean is too small for the points in it, which all lie on one side. So, for each flightline:

- the amount in a sphere is divided by the share of it over squares that beamlets cross
  (``VoxelPart.squares``): gaps of up to two squares are closed, since few beamlets leave gaps
  without an edge, and of squares along an edge the part counts that they have of the beamlets
  of those within, half of them where these are few;
- where squares are missing, the same ratio of the nine voxels around is taken if it is
  larger: a sliver's own share is known too badly;
- a layer in which the gate ends is taken as if it were listened to all through: along a beam the
  noise changes nowhere else, so what a beamlet that reaches into a layer stands for there, less
  than in the layer above or below, is made the same. Nine voxels tell how much less; beamlets
  count in every layer whose spheres they reach (:func:`~spl_batch.kernels.chords.cover`). Near the
  end itself the flightline counts in part (:mod:`~spl_batch.stages.gate_ends`);
- near the edge of a flightline it counts in part, by the beamlets over the squares around, whatever
  of them is covered, over those of their covered part: the test of single points looks so far, a
  metre or two. Where beamlets are too few to tell the edge, it counts within a square of those that
  are covered;
- within a voxel the noise goes with the beamlets over each square, linear between their centres: a
  turning scan makes ridges narrower than a voxel, the highest along the edge of a swath. Beams
  lean, and edges and ridges with them, by up to a square from layer to layer, so the squares are
  those around the place where a beam through the point crosses the middle of its layer: how beams
  lean there, the squares of all layers tell (:mod:`~spl_batch.stages.leaning`). A count is held for
  as much as its Poisson error lets it tell, first against those of the eight squares around and
  then against the voxel's mean, which is worth the less the more uneven its squares are
  (:mod:`~spl_batch.stages.beamlet_counts`). The density at the point is what is needed, not its
  integral over the ellipsoid: ``python -m benchmarks.null_calibration --only ridge``.

The flightlines add up by these parts. Where edges and ends are blurred over metres, as scans and
gates leave them, that is the true density at the point. A sharp edge, as that of a delivery, would
be blurred by it, so soon from the middle of an edge inwards a flightline counts for no less than
:data:`BESIDE_NOTHING`, and beyond it for less than what linear squares leave: an ellipsoid that
reaches across finds fewer neighbours, so a little less than the density keeps alpha in the last
metre. The less the first row of squares within an edge has of the beamlets of the second one, the
less sharp it is, and the less is made of it.
``benchmarks/null_calibration.py`` prints what the filter keeps of noise along sharp edges,
``benchmarks/null_edges.py`` along those of surveys.
"""

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.kernels.squares import density_between
from spl_batch.stages.beamlet_counts import (
    SQUARES,
    beamlets_around,
    halves,
    joined,
    nine,
    of_spheres,
    told,
    worth_of_mean,
)
from spl_batch.stages.gate_ends import Ends, at_least, ratio, to_the_ends
from spl_batch.stages.leaning import lean

DOMAIN: Final = "space"

MARGIN_VOXELS: Final = 2
"""Voxels on each side of a point's that its density depends on."""

FEW: Final = 8.0
"""Beamlets over a covered square that tell where within a square an edge lies [count]."""

BESIDE_NOTHING: Final = 0.9
"""Part in which a flightline counts at least within the middle of its sharp edge: it is linear over
a square, and yet the noise is whole there."""

BEYOND: Final = 0.4
"""Part that linear squares leave beyond a sharp edge at most."""

TAIL: Final = 0.15
"""Part of what is heard near by that is expected at least where something is heard."""

AROUND: Final = 4.0
"""Squares whose count is as sure as that of nine weighted by ``beamlet_counts.BLUR``."""


class Listened(NamedTuple):
    """What one flightline listens to, ready to be asked at points.

    Parameters
    ----------
    beamlets : (4 nx, 4 ny, nz) float64
        Beamlets over each square's covered part, as far as they can be told [count].
    there : (4 nx, 4 ny, nz) float32
        Beamlets over each square, whatever is covered [count].
    near : (4 nx, 4 ny, nz) bool
        Squares where the line counts.
    each : (nx, ny, nz) float64
        What one beamlet over a square stands for [1/m3].
    usual : (nx, ny, nz) float64
        Density of the covered part of each voxel [1/m3].
    worth : (nx, ny, nz) float64
        Beamlets that it is worth [count].
    lean : (2, nx, ny, nz) float64
        How far beams lean along x and y from a layer to the next one upwards [squares].
    edge : (4 nx, 4 ny, nz) float32
        How sharp the edge is where the flightline counts in part [0..1]; -1 elsewhere.
    ends : Ends
        Where the gate ends within a layer.
    """

    beamlets: NDArray[np.float64]
    there: NDArray[np.float32]
    near: NDArray[np.bool_]
    each: NDArray[np.float64]
    usual: NDArray[np.float64]
    worth: NDArray[np.float64]
    lean: NDArray[np.float64]
    edge: NDArray[np.float32]
    ends: Ends

    def at(
        self,
        voxel: tuple[NDArray[np.int64], ...],
        square: tuple[NDArray[np.int64], ...],
        offset: tuple[NDArray[np.float64], ...],
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Noise of the flightline around points, and in which part it counts.

        Parameters
        ----------
        voxel : three of (n,) int64
            Index of each point's voxel.
        square : two of (n,) int64
            Index of its square: :data:`SQUARES` along each edge of a voxel.
        offset : three of (n,) float64
            From the centre of the square, in squares, and of the voxel, in voxels [-0.5..0.5].

        Returns
        -------
        (n,) float64
            Where the flightline listens [1/m3]; 0 where it does not come near.
        (n,) float64
            Covered part around the points [0..1].
        """
        n = len(voxel[0])
        density, part, sharp = np.empty(n), np.empty(n), np.empty(n, np.float32)
        density_between(
            self.beamlets, self.there, self.near, self.each, self.usual, self.worth, self.lean,
            voxel[0], voxel[1], voxel[2], square[0], square[1], offset[0], offset[1], offset[2],
            AROUND, self.edge, density, part, sharp,
        )  # fmt: skip
        rim = np.flatnonzero(part < 1.0)
        density[rim[part[rim] <= 0.0]] = 0.0
        part[rim] = beside_an_edge(part[rim], sharp[rim])
        last = np.flatnonzero(self.ends.side[voxel] != 0)
        part[last] *= self.ends.part(
            tuple(axis[last] for axis in voxel), _of_voxels(square, offset, last)
        )
        return density, part


def beside_an_edge(part: NDArray[np.float64], sharp: NDArray[np.float32]) -> NDArray[np.float64]:
    """In which part a flightline counts, by what is left there by linear squares: (n,) float64.

    Parameters
    ----------
    part : (n,) float64
        What is left [0..1].
    sharp : (n,) float32
        How sharp the edge is [0..1].
    """
    clear = np.clip(2.0 * sharp - 1.0, 0.0, 1.0)
    outside = np.minimum(part, part * (1.0 - clear * (1.0 - part / BEYOND)))
    return at_least(np.where(part < BEYOND, outside, part), BESIDE_NOTHING * sharp, BEYOND)


def listened(
    amount: NDArray[np.int64], counts: NDArray[np.integer[Any]], voxel_m: float
) -> Listened | None:
    """What one flightline listens to; None where it does not come near.

    Parameters
    ----------
    amount : (nx, ny, nz) int64
        Sum of ``VoxelPart.amount`` of its stretches, :data:`MARGIN_VOXELS` wider on each
        side than the voxels that will be asked for.
    counts : (nx, ny, nz, 16) integer
        Sum of ``VoxelPart.squares``.
    voxel_m : float
        Edge of a voxel [m].
    """
    if not counts.any():
        return None
    beamlets = unpack(counts)
    near = joined(np.logical_or, beamlets > 0)
    closed = joined(np.logical_and, near)
    inner = _inner(closed)
    clear = joined(np.logical_or, beamlets_around(beamlets, closed) >= FEW)
    covered = _covered(beamlets, closed, inner, clear)
    each, points, last = to_the_ends(amount, beamlets, voxel_m)
    per_m3 = _of_covered(points, closed, covered)
    rim = clear & joined(np.logical_or, closed & ~inner)
    near = np.where(clear, closed, near) | rim
    found = told(beamlets, covered)
    number = of_spheres(beamlets)
    mean = ratio(nine(number), nine(of_spheres(covered)))
    leaning = lean(found.smooth, SQUARES**2 * number, mean)
    edge = np.where(rim, _sharp(beamlets, closed, inner), np.float32(-1.0))
    worth = worth_of_mean(found.smooth)
    return Listened(found.covered, beamlets, near, each, per_m3, worth, leaning, edge, last)


def around(
    lines: Sequence[Listened],
    voxel: tuple[NDArray[np.int64], ...],
    square: tuple[NDArray[np.int64], ...],
    offset: tuple[NDArray[np.float64], ...],
) -> NDArray[np.float64]:
    """Noise of all flightlines together around points: (n,) [1/m3].

    Parameters
    ----------
    lines : sequence of Listened
        All that come near.
    voxel, square, offset
        As :meth:`Listened.at` takes them.
    """
    total, largest = np.zeros(len(offset[0])), np.zeros(len(offset[0]))
    for line in lines:
        density, part = line.at(voxel, square, offset)
        total += part * density
        np.maximum(largest, density, out=largest)
    return np.maximum(total, TAIL * largest)


def _of_voxels(
    square: tuple[NDArray[np.int64], ...],
    offset: tuple[NDArray[np.float64], ...],
    rows: NDArray[np.intp],
) -> tuple[NDArray[np.float64], ...]:
    """Offsets of some points from the centres of their voxels [voxels]."""
    across, along = (
        (index[rows] % SQUARES + 0.5 + part[rows]) / SQUARES - 0.5
        for index, part in zip(square, offset, strict=False)
    )
    return across, along, offset[2][rows]


def unpack(counts: NDArray[np.integer[Any]]) -> NDArray[np.float32]:
    """Squares of voxels: (4 nx, 4 ny, nz) float32 from (nx, ny, nz, 16)."""
    nx, ny, nz = counts.shape[:3]
    apart = counts.reshape(nx, ny, nz, SQUARES, SQUARES).transpose(0, 3, 1, 4, 2)
    return apart.astype(np.float32).reshape(nx * SQUARES, ny * SQUARES, nz)


def _inner(squares: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Those with four others beside them."""
    inner = squares.copy()
    for axis in (0, 1):
        ahead, behind = halves(axis)
        inner[ahead] &= squares[behind]
        inner[behind] &= squares[ahead]
    return inner


def _covered(
    beamlets: NDArray[np.float32],
    closed: NDArray[np.bool_],
    inner: NDArray[np.bool_],
    clear: NDArray[np.bool_],
) -> NDArray[np.float32]:
    """Part of each square that is covered: 1 inside, along a clear edge what beamlets tell."""
    usual = beamlets_around(np.where(inner, beamlets, np.float32(0.0)), inner)
    part = np.full(beamlets.shape, 0.5, dtype=np.float32)
    np.divide(beamlets, usual, out=part, where=clear & (usual > 0.0))
    np.minimum(part, np.float32(1.0), out=part)
    part[inner] = 1.0
    part[~closed] = 0.0
    return part


def _sharp(
    beamlets: NDArray[np.float32], closed: NDArray[np.bool_], inner: NDArray[np.bool_]
) -> NDArray[np.float32]:
    """How sharp an edge is by the first row of squares within it over the second one: [0..1].

    Along a sharp edge the first row has as many beamlets as the second; the rims of scans have
    fewer and fewer over many metres. 1 where that is not known.
    """
    none, second = np.float32(0.0), _inner(inner)
    first = inner & ~second
    beyond = beamlets_around(np.where(second, beamlets, none), second)
    told = first & (beyond > 0.0)
    more, fewer = (
        beamlets_around(np.where(told, counts, none), told) for counts in (beyond, beamlets)
    )
    edge = closed & ~inner & (more > 0.0)
    ratio = np.where(edge, np.minimum(fewer / np.where(edge, more, 1.0), 1.0), none)
    found = beamlets_around(ratio.astype(np.float32), edge)
    found[~joined(np.logical_or, edge)] = 1.0
    return found


def _of_covered(
    points: NDArray[np.float64], squares: NDArray[np.bool_], weight: NDArray[np.float32]
) -> NDArray[np.float64]:
    """Density of the covered part of voxels from that of the whole ones [1/m3]."""
    share = of_spheres(weight)
    some = share > 0.0
    points = np.where(some, points, 0.0)
    own = points / np.where(some, share, 1.0)
    nx, ny, nz = points.shape
    cut = some & ~squares.reshape(nx, SQUARES, ny, SQUARES, nz).all(axis=(1, 3))
    pooled = nine(points)[cut] / nine(share)[cut]
    own[cut] = np.maximum(own[cut], pooled)
    return own
