"""Records of any point format into formats 6-10 with extra dimensions [LAS 1.4 R15, section 4].

laspy refuses a file whose extra bytes have a name twice, or one that the record has already, a text
that is no UTF-8, or a scale that is no number: a copy describes such a dimension anew.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from laspy.vlrs.known import ExtraBytesStruct
from numpy.typing import NDArray

from spl_batch.formats.las.header import standard_dtype
from spl_batch.formats.las.records import (
    ADDED,
    FIRST_CLASS,
    FIRST_EXTENDED_FORMAT,
    SCAN_ANGLE_STEP_DEG,
    ExtraDimension,
    RecordLayout,
    added,
    dimension,
    standard_names,
)

EXTENDED_FORMAT: Final = {0: 6, 1: 6, 2: 7, 3: 7, 4: 9, 5: 10}
"""Point format of LAS 1.4 that holds all of an older one."""

_LEGACY_OVERLAP_CLASS: Final = 12
_OVERLAP_BIT: Final = 8
_REPLACED: Final = frozenset(added(name).descriptor for name in ADDED if name != FIRST_CLASS)
"""Descriptors of what an earlier run added and no copy keeps."""


def copied_format(point_format: int) -> int:
    """Point format of a copy of a file of one."""
    return EXTENDED_FORMAT.get(point_format, point_format)


@dataclass(frozen=True, slots=True)
class Conversion:
    """How records of one layout become records of another."""

    given: RecordLayout
    layout: RecordLayout
    kept: tuple[tuple[str, str], ...]  #: Fields of extra dimensions: before, after.
    mended: tuple[str, ...] = ()  #: Names of extra dimensions that are described anew.

    def records(self, given: NDArray[Any]) -> NDArray[Any]:
        """Records, (n,), of the layout before, as those of the layout after; what is added is 0."""
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


def conversion(given: RecordLayout, added: Sequence[ExtraDimension]) -> Conversion:
    """Conversion into an extended point format with dimensions added.

    ``added``: dimensions of the output; one of the input that is described alike is dropped, one
    of the same name gets another.
    """
    point_format = copied_format(given.point_format)
    taken = {
        *standard_names(point_format),
        *(standard_dtype(point_format).names or ()),
        *(d.name for d in added),
    }
    old = [d for d in given.extra if d.descriptor not in _REPLACED]
    new: list[ExtraDimension] = []
    for before in old:
        new.append(_sound(before, taken))
        taken.add(new[-1].name)
    numbered = [replace(d, field=f"extra_{i}") for i, d in enumerate([*new, *added])]
    pairs = list(zip(old, numbered, strict=False))
    return Conversion(
        given,
        RecordLayout(point_format, tuple(numbered)),
        tuple((before.field, after.field) for before, after in pairs),
        tuple(after.name for before, after in pairs if before.descriptor != after.descriptor),
    )


def _sound(dimension: ExtraDimension, taken: Collection[str]) -> ExtraDimension:
    """A dimension as standard readers take it."""
    described = ExtraBytesStruct.from_buffer_copy(dimension.descriptor)
    known = described.name.decode("utf-8", errors="ignore") or "unnamed"
    name = _free(known, taken).encode()
    text = described.description.decode("utf-8", errors="ignore").encode()
    if name != described.name:
        described.name = name.ljust(32, b"\0")
    if text != described.description:
        described.description = text.ljust(32, b"\0")
    scale, offset = dimension.scale, dimension.offset
    scales, offsets = (described.scale or (), described.offset or ())
    if not (np.all(scales) and np.isfinite([*scales, *offsets]).all()):
        scale = offset = described.scale = described.offset = None
    return replace(
        dimension, name=name.decode(), scale=scale, offset=offset, descriptor=bytes(described)
    )


def _free(name: str, taken: Collection[str]) -> str:
    """The name, or, where it is taken, it and the first number that is free."""
    found, k = name, 2
    while found in taken:
        ending = f"_{k}"
        found = name.encode()[: 32 - len(ending)].decode("utf-8", errors="ignore") + ending
        k += 1
    return found


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
