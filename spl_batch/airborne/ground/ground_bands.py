"""Ground of a cell that does not fit into memory as a whole: band by band.

Domain: space. See :mod:`spl_batch.airborne.ground.ground_methods`; the same points are ground.
"""

from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.beams.dependent_returns import dependents
from spl_batch.airborne.ground.ground_methods import metres
from spl_batch.airborne.ground.multiscale.lines_apart import Lines
from spl_batch.airborne.ground.multiscale.masks import Strip, multiscale_masks
from spl_batch.airborne.ground.multiscale.ranging_layer import EVERYWHERE, evidence, reckoned
from spl_batch.airborne.ground.point_spacing import Squares, added_up
from spl_batch.lattice.tables import PointTable


class Band(NamedTuple):
    """Some of the points of a ground cell: those of whole blocks.

    Parameters
    ----------
    table : PointTable
        The points.
    usable, asked : (n,) bool
        As :func:`~spl_batch.airborne.ground.ground_methods.ground_mask` has them.
    origin : object
        Where the caller found them.
    lines : Lines, optional
        Their flightlines, where there are several.
    """

    table: PointTable
    usable: NDArray[np.bool_]
    asked: NDArray[np.bool_]
    origin: Any = None
    lines: Lines | None = None


def ground_in_bands(
    bands: Callable[[], Iterable[Band]],
) -> Iterator[tuple[Band, NDArray[np.uint8]]]:
    """Labels by the method that follows the data, band by band.

    Parameters
    ----------
    bands : callable
        Gives the bands of a ground cell and its buffer; it is called several times, and no band is
        held while the next is made.

    Returns
    -------
    iterator of (Band, (n,) uint8)
        Each band, and labels of its points.
    """
    if not any(map(_has_evidence, bands())):
        return ((band, np.zeros(len(band.table), np.uint8)) for band in bands())
    shown = [some for some in map(_shown, bands()) if some is not None]
    sigma = reckoned(added_up(shown)) if shown else EVERYWHERE
    return map(_of_table, multiscale_masks(lambda: map(_strip, bands()), sigma))


def _has_evidence(band: Band) -> bool:
    return bool(_evidence(band).any())


def _shown(band: Band) -> Squares | None:
    """What a band shows of its ranges; None where no flightline tells of these."""
    own = _evidence(band)
    if "range_sigma" not in band.table or not own.any():
        return None
    return evidence(*metres(band.table, own), band.table["range_sigma"][own])


def _strip(band: Band) -> Strip:
    """Places of a band's points; it remembers the band, and which points are asked."""
    own, told = _evidence(band), band.usable & band.asked
    of_own, of_told = (
        None if band.lines is None else band.lines.some(chosen) for chosen in (own, told)
    )
    return Strip(
        metres(band.table, own), metres(band.table, told), (band, told), of_own, of_told
    )  # fmt: skip


def _evidence(band: Band) -> NDArray[np.bool_]:
    return band.usable & ~dependents(band.table)


def _of_table(told: tuple[Strip, NDArray[np.uint8]]) -> tuple[Band, NDArray[np.uint8]]:
    """What was found of a strip, for all points of its band."""
    strip, found = told
    band, asked = strip.known_as
    mask = np.zeros(len(band.table), np.uint8)
    mask[asked] = found
    return band, mask
