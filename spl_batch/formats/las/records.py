"""Layout of LAS point records: names, bits and extra bytes [LAS 1.4 R15, sections 2.6, 4]."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, Final

import laspy
import numpy as np
from laspy.point.dims import get_sub_fields_dict
from laspy.vlrs.known import ExtraBytesStruct
from numpy.typing import NDArray

from spl_batch.constants import (
    CLASS_HIGH_NOISE,
    CLASS_LOW_NOISE,
    NOISE_AFTERPULSE,
    NOISE_BACKGROUND,
)
from spl_batch.formats.declared import bounded
from spl_batch.formats.las.header import MAX_LENGTH, REWRITE, LasHeader, standard_dtype

EXTRA_BYTES_KEY: Final = ("LASF_Spec", 4)
DESCRIPTOR_SIZE: Final = 192
FIRST_EXTENDED_FORMAT: Final = 6
SCAN_ANGLE_STEP_DEG: Final = 0.006
"""Unit of the scan angle in point formats 6-10 [deg]."""

ADDED: Final[Mapping[str, tuple[str, str]]] = {
    "input_classification": ("u1", "class of the input file"),
    "noise_class": ("u1", "0 signal 1 backgr 2 afterp 255 -"),
    "noise_density": ("f4", "expected noise points per m3"),
    "p_value": ("f4", "P(this many neighbours | noise)"),
    "HeightAboveGround": ("f4", "height above dtm.tif, its unit"),
}
"""Extra bytes that this project adds: dtype and description."""

HEIGHT: Final = "HeightAboveGround"
"""Of these, what PDAL calls the height above the terrain, too."""

FIRST_CLASS: Final = "input_classification"
"""Of these, what a copy keeps of an earlier output."""

_TYPES: Final = ("u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f4", "f8")


@dataclass(frozen=True, slots=True)
class ExtraDimension:
    """One described dimension in the extra bytes of a record."""

    name: str
    field: str  #: Name of the field in the record's dtype; differs from every standard one.
    dtype: np.dtype[Any]
    #: Value = raw scale + offset, where the descriptor asks for it.
    scale: float | None
    offset: float | None
    descriptor: bytes  #: The 192 bytes that describe it.


@dataclass(frozen=True, slots=True)
class RecordLayout:
    """What the bytes of a point record mean."""

    point_format: int
    extra: tuple[ExtraDimension, ...]

    @property
    def dtype(self) -> np.dtype[Any]:
        """Packed dtype of one record."""
        standard = standard_dtype(self.point_format)
        fields: list[tuple[str, Any]] = [(name, standard[name]) for name in standard.names or ()]
        return np.dtype(fields + [(d.field, d.dtype) for d in self.extra])

    @property
    def names(self) -> tuple[str, ...]:
        """Dimensions that can be asked for by name."""
        return standard_names(self.point_format) + tuple(d.name for d in self.extra)


@cache
def standard_names(point_format: int) -> tuple[str, ...]:
    """Dimensions of a record without extra bytes, bits of a field each for itself."""
    return tuple(laspy.PointFormat(point_format).standard_dimension_names)


def record_layout(header: LasHeader) -> RecordLayout:
    """Layout of a file's point records.

    Raises
    ------
    InputError
        If the extra bytes' description contradicts the record length.
    """
    base = standard_dtype(header.point_format).itemsize
    room = header.record_size - base
    extra: list[ExtraDimension] = []
    vlr = header.vlr(*EXTRA_BYTES_KEY)
    data = b"" if vlr is None else vlr.data
    for start in range(0, len(data) - DESCRIPTOR_SIZE + 1, DESCRIPTOR_SIZE):
        raw = data[start : start + DESCRIPTOR_SIZE]
        # Common readers misunderstand extra bytes without a type, whose options are its size.
        untyped = raw[2] == 0
        extra += _plain(raw[3], len(extra)) if untyped else [_dimension(header, raw, len(extra))]
    held = sum(d.dtype.itemsize for d in extra)
    left = room - bounded(
        header.path, "extra bytes that are described", held, most=room, remedy=REWRITE
    )
    extra += _plain(left, len(extra))
    remedy = "the header is damaged, or the file needs converting"
    most = MAX_LENGTH // DESCRIPTOR_SIZE
    bounded(header.path, "dimensions in the extra bytes", len(extra), most=most, remedy=remedy)
    return RecordLayout(header.point_format, tuple(extra))


def _plain(size: int, first: int) -> list[ExtraDimension]:
    """Names for bytes that nothing describes, so that a copy can carry them along."""
    types = ["<u8"] * (size // 8) + ["u1"] * (size % 8)
    return [
        replace(
            new_dimension(f"undescribed_{k}", np.dtype(plain), ""), field=f"extra_{k}"
        )
        for k, plain in enumerate(types, first)
    ]  # fmt: skip


def new_dimension(name: str, dtype: np.dtype[Any], text: str) -> ExtraDimension:
    """Extra dimension of a plain numeric dtype, named and described in 32 ASCII characters each.

    [LAS 1.4 R15, table 24].
    """
    plain = np.dtype(dtype)
    described = ExtraBytesStruct.from_buffer_copy(bytes(DESCRIPTOR_SIZE))
    described.data_type = _TYPES.index(f"{plain.kind}{plain.itemsize}") + 1
    described.name, described.description = name.encode("ascii"), text.encode("ascii")
    return ExtraDimension(name, name, plain, None, None, bytes(described))


def rescaled(one: ExtraDimension, factor: float) -> ExtraDimension:
    """A dimension whose values are ``factor`` times as large; raw values, their bounds too, stay.

    [LAS 1.4 R15, table 24].
    """
    if factor == 1.0:
        return one
    described = ExtraBytesStruct.from_buffer_copy(one.descriptor)
    described.scale = [factor * scale for scale in described.scale or (1.0,) * 3]
    described.offset = described.offset and [factor * offset for offset in described.offset]
    offset = described.offset and described.offset[0]
    return replace(one, scale=described.scale[0], offset=offset, descriptor=bytes(described))


@cache
def added(name: str) -> ExtraDimension:
    """Dimension of :data:`ADDED`; a file that describes one like that is an earlier output."""
    dtype, text = ADDED[name]
    return new_dimension(name, np.dtype(dtype), text)


def given_classes(records: NDArray[Any], layout: RecordLayout) -> NDArray[np.uint8]:
    """Classes that records came with, (n,); for noise of an earlier run those before that run."""
    classes: NDArray[np.uint8] = dimension(records, layout, "classification")
    own = {d.descriptor: d.field for d in layout.extra}
    first, noise = (own.get(added(n).descriptor) for n in ("input_classification", "noise_class"))
    if first is None or noise is None:
        return classes
    labelled = np.isin(records[noise], (NOISE_BACKGROUND, NOISE_AFTERPULSE))
    return np.where(
        labelled & np.isin(classes, (CLASS_LOW_NOISE, CLASS_HIGH_NOISE)), records[first], classes
    )


def _dimension(header: LasHeader, raw: bytes, number: int) -> ExtraDimension:
    described = ExtraBytesStruct.from_buffer_copy(raw)
    name = described.name.decode("utf-8", errors="replace")
    what = f"data type of extra dimension {name!r}"
    bounded(header.path, what, described.data_type, most=3 * len(_TYPES), remedy=REWRITE)
    scale, offset = (None if v is None else v[0] for v in (described.scale, described.offset))
    return ExtraDimension(name, f"extra_{number}", described.dtype(), scale, offset, raw)


def dimension(records: NDArray[Any], layout: RecordLayout, name: str) -> NDArray[Any]:
    """Values of one dimension.

    Parameters
    ----------
    records : (n,) structured
        Point records of this layout.
    name : str
        One of :attr:`RecordLayout.names`.

    Returns
    -------
    (n,) or (n, k) ndarray
        Bit fields as uint8, scaled extra dimensions as float64, others as stored.
    """
    bits = get_sub_fields_dict(layout.point_format)
    if name in bits:
        field, part = bits[name]
        shift = (part.mask & -part.mask).bit_length() - 1
        unpacked: NDArray[np.uint8] = (records[field] & np.uint8(part.mask)) >> np.uint8(shift)
        return unpacked
    extra = next((d for d in layout.extra if d.name == name), None)
    if extra is None or name in (records.dtype.names or ()):
        stored: NDArray[Any] = records[name]
        return stored
    values: NDArray[Any] = records[extra.field]
    if extra.scale is None and extra.offset is None:
        return values
    scale = 1.0 if extra.scale is None else extra.scale
    offset = 0.0 if extra.offset is None else extra.offset
    scaled: NDArray[Any] = values * scale + offset
    return scaled
