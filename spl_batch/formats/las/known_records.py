"""CRS of a LAS header, and records that a copy does without, as they are broken or contradicted.

What is delivered must open everywhere; a damaged record may make a reader fail on a whole file.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import laspy
import numpy as np
from laspy.vlrs.known import BaseKnownVLR
from pyproj import CRS, Transformer
from pyproj.exceptions import CRSError, ProjError

from spl_batch.errors import is_fault, one_line, plain, shortened
from spl_batch.formats.crs import (
    LIBLAS_KEY,
    WKT_KEY,
    compound,
    crs_from_wkt,
    crs_name,
    differences,
    horizontal,
    same_crs,
    vertical,
)
from spl_batch.formats.geotiff_keys import GEO_KEYS, contradicted_unit, crs_from_geotiff
from spl_batch.formats.heights import (
    names_datum,
    other_heights,
    states_heights,
    with_heights_of,
)
from spl_batch.formats.las.chunks import LASZIP_KEY
from spl_batch.formats.las.frame import wkt_vlr
from spl_batch.formats.las.header import (
    EXTERNAL_BIT,
    WAVEFORM_FORMATS,
    WKT_BIT,
    Evlr,
    LasHeader,
    Vlr,
    open_input,
    waveform_file,
)
from spl_batch.formats.las.records import EXTRA_BYTES_KEY
from spl_batch.formats.units import Units

_PARSED_BYTES: Final = 1 << 20
"""Longest record that is parsed [byte]: known ones are short, longer ones are copied."""

_CRS_TEXT_MAX: Final = 150
"""Characters that are quoted of a CRS that is not understood [count]."""

_SAME_POSITION_M: Final = 10.0
"""Two CRS contradict each other where the same coordinates lie farther apart [m]; how they name a
datum does not matter."""


def header_crs(header: LasHeader) -> tuple[CRS | None, tuple[str, ...]]:
    """CRS of a file, and what is odd about its record.

    A record that cannot be understood counts as missing, with a warning: the workflow then has to
    name the CRS.
    """
    rivals = _rivals(header)
    if rivals is not None:
        names, bit = [crs_name(crs) for crs in rivals], _keys_count(header)
        apart = differences(*rivals)
        text = (
            f"its WKT record names {names[0]}, its GeoTIFF keys {names[1]}"
            f"{f' ({apart})' if apart else ''}: the "
            f"{'keys count' if bit else 'record counts'}, by the header's WKT bit and point format;"
            " correct the file if that is wrong"
        )
        return rivals[bit], (text,)
    try:
        known = _of_both(header) or _wkt_crs(header) or _keys_crs(header)
        odd = contradicted_unit(_keys(header)[0])
        return known or _liblas_crs(header), (odd,) if odd else ()
    except CRSError as error:
        reason = shortened(plain(" ".join(str(error).split())), _CRS_TEXT_MAX)
        return None, (f"the CRS record is not understood ({reason}): name the CRS in survey.crs",)


def _keys_count(header: LasHeader) -> bool:
    """Whether GeoTIFF keys count more than a WKT record [LAS 1.4 R15, 2.4 and 3]."""
    return header.point_format < 6 and not header.global_encoding & WKT_BIT


def _rivals(header: LasHeader) -> tuple[CRS, CRS] | None:
    """CRS of the WKT record and of the GeoTIFF keys, where they contradict each other."""
    if header.vlr(*GEO_KEYS[0]) is None or not header.n_points:
        return None
    try:
        wkt = _wkt_crs(header) or _liblas_crs(header)
        keys = None if wkt is None else _keys_crs(header)
        if wkt is None or keys is None or _agree(wkt, keys, header):
            return None
    except (CRSError, ProjError):
        return None  # what is not understood contradicts nothing
    return wkt, keys


def _agree(a: CRS, b: CRS, header: LasHeader) -> bool:
    """Whether two CRS put the middle of a file at the same position.

    Heights that one alone states, or whose datum one alone names, contradict nothing.
    """
    both, units = states_heights(a) and states_heights(b), {Units.of(x).vertical_m for x in (a, b)}
    if both and (len(units) > 1 or other_heights(a, b)):
        return False
    flat = horizontal(a), horizontal(b)
    if same_crs(a, b) or not all(crs.is_projected or crs.is_geographic for crs in flat):
        return True
    middle = np.mean([header.mins_m[:2], header.maxs_m[:2]], axis=0)
    there = Transformer.from_crs(*flat, always_xy=True).transform(*middle)
    return bool(np.hypot(*(there - middle)) < _SAME_POSITION_M)


def _of_both(header: LasHeader) -> CRS | None:
    """CRS of a WKT record with heights that GeoTIFF keys beside it alone state; else none."""
    try:
        wkt, keys = _wkt_crs(header), _keys_crs(header)
    except CRSError:
        return None
    if wkt is None or keys is None or states_heights(wkt) or not states_heights(keys):
        return None
    return with_heights_of(wkt, keys)


def _keys_crs(header: LasHeader) -> CRS | None:
    directory, doubles, text = _keys(header)
    return crs_from_geotiff(directory, doubles, text) if directory else None


def _keys(header: LasHeader) -> tuple[bytes, ...]:
    """Directory, doubles and text of GeoTIFF keys; empty where there are none."""
    return tuple(b"" if vlr is None else vlr.data for vlr in (header.vlr(*k) for k in GEO_KEYS))


def _wkt_crs(header: LasHeader) -> CRS | None:
    records: tuple[Vlr | Evlr, ...] = (*header.vlrs, *header.evlrs)
    found = next((record for record in records if record.key == WKT_KEY), None)
    return None if found is None else crs_from_wkt(_content(header.path, found))


def _liblas_crs(header: LasHeader) -> CRS | None:
    """CRS of libLAS's record, which counts where there is no other: it has no vertical part."""
    vlr = header.vlr(*LIBLAS_KEY)
    return None if vlr is None else crs_from_wkt(vlr.data)


def broken_records(header: LasHeader) -> Iterator[str]:
    """What of a file's header a copy does without, a text for each.

    Records that cannot be parsed, and the name of a file of waveforms that is not there.
    """
    records: list[Vlr | Evlr] = [*header.vlrs, *header.evlrs]
    for record in records:
        fault = record_fault(header.path, record)
        if fault is not None:
            name = ascii(record.user_id.rstrip(b"\0").decode("latin-1")).strip("'")
            yield f"header record {name} {record.record_id} cannot be parsed ({fault})"
    external = header.point_format in WAVEFORM_FORMATS and header.global_encoding & EXTERNAL_BIT
    if external and waveform_file(header.path, header.point_format) is None:
        name = header.path.with_suffix(".wdp").name
        yield f"its header names waveforms in {name}, which is not beside it"


def record_fault(path: Path, record: Vlr | Evlr) -> str | None:
    """Why laspy cannot parse a record of a file; None where it can, or does not look into it."""
    try:
        name, description = (
            text.split(b"\0")[0].decode() for text in (record.user_id, record.description)
        )
        if isinstance(record, Evlr) and record.size > _PARSED_BYTES:
            return None
        for kind in BaseKnownVLR.__subclasses__():
            ids = kind.official_record_ids()
            if kind.official_user_id() == name and record.record_id in ids:
                content = _content(path, record)
                kind.from_raw(laspy.VLR(name, record.record_id, description, content))
    except BaseException as error:
        if not is_fault(error):
            raise
        return one_line(error)
    return None


def _content(path: Path, record: Vlr | Evlr) -> bytes:
    """Content of a record, of a long one its beginning."""
    if isinstance(record, Vlr):
        return record.data
    with open_input(path) as file:
        file.seek(record.start)
        return file.read(min(record.size, _PARSED_BYTES))


def kept_records(header: LasHeader, crs: CRS | None) -> tuple[list[Vlr], list[Evlr], bool]:
    """Records and extended records that a copy keeps, and whether none but WKT gives a CRS."""
    dropped = {LASZIP_KEY, EXTRA_BYTES_KEY}
    if _rivals(header) is not None:  # what does not count goes
        dropped.update((WKT_KEY, LIBLAS_KEY) if _keys_count(header) else GEO_KEYS)
    own = header_crs(header)[0]
    written = _delivered_crs(own, crs)
    if written is not own or _of_both(header) is not None:
        dropped.update((WKT_KEY, LIBLAS_KEY))

    def is_kept(record: Vlr | Evlr) -> bool:
        gone = record.key in dropped or record.key[0] == "copc"
        return not gone and record_fault(header.path, record) is None

    vlrs, evlrs = [*filter(is_kept, header.vlrs)], [*filter(is_kept, header.evlrs)]
    known = WKT_KEY in {v.key for v in vlrs} | {e.key for e in evlrs}
    if not known and written is not None:
        vlrs.append(wkt_vlr(written))
    keys = {v.key for v in vlrs}
    return vlrs, evlrs, known or WKT_KEY in keys or not keys.intersection(GEO_KEYS)


def _delivered_crs(own: CRS | None, survey: CRS | None) -> CRS | None:
    """CRS of a delivered cloud, by that of its input and that of the survey."""
    if survey is None:
        return own
    if own is None or own.is_geocentric:  # not understood, or wrong over coordinates in metres
        return survey
    heights = vertical(survey)
    if heights is None or names_datum(own) or (vertical(own) and not names_datum(survey)):
        return own
    return compound(own, heights)
