"""Layered LAZ with other classes and more extra bytes, without decoding what stays.

A chunk of point formats 6-10 keeps each field in a layer of its own: the first record as it is, the
number of points, the size of every layer, the layers. The coding of classes depends on the returns
of a pulse and the scanner channel, that of flags and an extra byte on the scanner channel alone
[LASzip, ``laswriteitemcompressed_v3.cpp``]. So a copy takes the layers of all other fields from the
input, and these from records in which nothing else is set. It decodes as if all had been compressed
anew; where the input is of the same compressor it is the same bytes.

Of each of the input's records one number is needed (:func:`given_of`), kept by whoever has decoded
them once.
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.formats.las.chunks import (
    CHUNK_POINTS_MAX,
    CHUNK_SIZE,
    CHUNK_SIZE_AT,
    RecordReader,
    chunk_layers,
    count_layers,
    laszip_items,
)
from spl_batch.formats.las.convert import Conversion
from spl_batch.formats.las.frame import laz_record, packed_chunk
from spl_batch.formats.las.records import RecordLayout, given_classes

GIVEN: Final = "given"
"""Name of the column of :func:`given_of`."""

_COPIED_FORMATS: Final = (6, 7, 8)
_FORMAT: Final = 6
_CLASSES: Final = 2
_FLAGS: Final = 3
"""Positions of the layers of classes and of flags among those of a format."""


def given_of(records: NDArray[Any], layout: RecordLayout) -> NDArray[np.uint32]:
    """Class, returns and flags of records of point formats 6-10 in one number: (n,) uint32."""
    given: NDArray[np.uint32] = records["classification_flags"].astype(np.uint32)
    for values in (records["bit_fields"], given_classes(records, layout)):
        given <<= np.uint32(8)
        given |= values
    return given


def can_be_copied(reader: RecordReader) -> bool:
    """Whether a file's layers are coded as those that are written."""
    if not reader.laszip or reader.layout.point_format not in _COPIED_FORMATS:
        return False
    ours = bytes(laz_record(reader.layout).record_data())
    return count_layers(reader.laszip) > 0 and laszip_items(ours) == laszip_items(reader.laszip)


class LayerCopy:
    """Copies chunks of a file that :func:`can_be_copied` with other classes and more extra bytes.

    ``added`` dimensions, the last ones, are the copy's own, and with ``flags`` the flags as well.
    """

    def __init__(
        self, reader: RecordReader, convert: Conversion, added: int, *, flags: bool = False
    ) -> None:
        points = CHUNK_SIZE.unpack_from(reader.laszip, CHUNK_SIZE_AT)[0]
        self.laz = laz_record(convert.layout, points)
        self._convert = convert
        self._given_dtype = convert.given.dtype
        self._given_layers = count_layers(reader.laszip)
        self.own = RecordLayout(_FORMAT, convert.layout.extra[len(convert.layout.extra) - added :])
        self._own_dtype = self.own.dtype
        self._own_laz = laz_record(self.own, CHUNK_POINTS_MAX)
        self._own_layers = count_layers(bytes(self._own_laz.record_data()))
        self._added_bytes = sum(d.dtype.itemsize for d in self.own.extra)
        self._kept = self._kept_layers()
        self._changed = (_CLASSES, _FLAGS) if flags else (_CLASSES,)

    def _kept_layers(self) -> list[int]:
        """Layers of the input that the copy has too, in order."""
        kept = {before for before, _ in self._convert.kept}
        extra = self._convert.given.extra
        sizes = [d.dtype.itemsize for d in extra]
        fixed = self._given_layers - sum(sizes)
        bytes_kept = np.repeat(np.array([d.field in kept for d in extra], np.bool_), sizes)
        return [*range(fixed), *(fixed + np.flatnonzero(bytes_kept)).tolist()]

    def records(self, given: NDArray[np.uint32]) -> NDArray[Any]:
        """Records of the layout ``own`` with class, returns and flags as given."""
        records = np.zeros(len(given), self._own_dtype)
        for shift, name in enumerate(("classification", "bit_fields", "classification_flags")):
            records[name] = given >> np.uint32(8 * shift) & np.uint32(255)
        return records

    def first(self, packed: bytes) -> NDArray[Any]:
        """First record of a chunk, (1,) with the copy's layout; what it adds is zero."""
        return self._convert.records(np.frombuffer(packed, self._given_dtype, 1))

    def chunk(self, packed: bytes, first: NDArray[Any], own: NDArray[Any]) -> bytes:
        """Bytes of a chunk of the copy.

        Parameters
        ----------
        first : (1,) structured
            From :meth:`first`, with class and added dimensions.
        own : (n,) structured
            From :meth:`records`, with the same for all points.
        """
        theirs = chunk_layers(packed, self._given_dtype.itemsize, self._given_layers)
        ours = chunk_layers(packed_chunk(own, self._own_laz), own.dtype.itemsize, self._own_layers)
        layers = [theirs[k] for k in self._kept]
        for layer in self._changed:
            layers[layer] = ours[layer]
        layers += ours[self._own_layers - self._added_bytes :]
        sizes = np.array([len(own), *map(len, layers)], "<u4")
        return b"".join([first.tobytes(), sizes.tobytes(), *layers])
