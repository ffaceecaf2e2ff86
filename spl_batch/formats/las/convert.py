"""Records of any point format into formats 6-10 with extra dimensions [LAS 1.4 R15, section 4]."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.formats.las.descriptors import in_order
from spl_batch.formats.las.records import (
    FIRST_EXTENDED_FORMAT,
    SCAN_ANGLE_STEP_DEG,
    ExtraDimension,
    RecordLayout,
    dimension,
    standard_dtype,
)

EXTENDED_FORMAT: Final = {0: 6, 1: 6, 2: 7, 3: 7, 4: 9, 5: 10}
"""Point format of LAS 1.4 that holds all of an older one."""

_LEGACY_OVERLAP_CLASS: Final = 12
_OVERLAP_BIT: Final = 8


@dataclass(frozen=True, slots=True)
class Conversion:
    """How records of one layout become records of another."""

    given: RecordLayout
    layout: RecordLayout
    kept: tuple[tuple[str, str], ...]  #: Fields of extra dimensions: before, after.

    def records(self, given: NDArray[Any]) -> NDArray[Any]:
        """Converted records; added dimensions are zero.

        Parameters
        ----------
        given : (n,) structured
            Records of the layout before.

        Returns
        -------
        (n,) structured
            Records of the layout after.
        """
        out = np.zeros(len(given), dtype=self.layout.dtype)
        shared = set(self.given.dtype.names or ()) & set(self.layout.dtype.names or ())
        standard = standard_dtype(self.layout.point_format).names or ()
        for name in shared.intersection(standard) - {"bit_fields"}:
            out[name] = given[name]
        if self.given.point_format >= FIRST_EXTENDED_FORMAT:
            out["bit_fields"] = given["bit_fields"]
        else:
            _extend(out, given, self.given)
        for before, after in self.kept:
            out[after] = given[before]
        return out


def copied_format(point_format: int) -> int:
    """Point format of a copy of a file of one."""
    return EXTENDED_FORMAT.get(point_format, point_format)


def conversion(given: RecordLayout, added: Sequence[ExtraDimension]) -> Conversion:
    """Conversion into an extended point format with dimensions added.

    ``added``: dimensions of the output; one of the input that is described alike is dropped, one
    of the same name gets another. What standard readers do not take of descriptors is put in order.
    """
    point_format = copied_format(given.point_format)
    pairs = [(old, new) for old, new, _ in in_order(given.extra, point_format, added)]
    numbered = [
        replace(d, field=f"extra_{i}") for i, d in enumerate([*(new for _, new in pairs), *added])
    ]
    kept = tuple((old.field, d.field) for (old, _), d in zip(pairs, numbered, strict=False))
    return Conversion(given, RecordLayout(point_format, tuple(numbered)), kept)


def _extend(out: NDArray[Any], given: NDArray[Any], layout: RecordLayout) -> None:
    def bits(name: str) -> NDArray[np.uint8]:
        values: NDArray[np.uint8] = dimension(given, layout, name)
        return values

    out["bit_fields"] = bits("return_number") | bits("number_of_returns") << 4
    classes = bits("classification")
    # Class 12 means overlap up to format 5; later formats have a flag for it instead.
    overlap = (classes == _LEGACY_OVERLAP_CLASS) * np.uint8(_OVERLAP_BIT)
    out["classification_flags"] = (
        bits("synthetic")
        | bits("key_point") << 1
        | bits("withheld") << 2
        | overlap
        | bits("scan_direction_flag") << 6
        | bits("edge_of_flight_line") << 7
    )
    out["classification"] = classes
    out["scan_angle"] = np.rint(given["scan_angle_rank"] / SCAN_ANGLE_STEP_DEG)
