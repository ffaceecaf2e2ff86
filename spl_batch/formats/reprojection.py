"""Delivered clouds and rasters in another CRS or unit, by PROJ, heights too where named."""

from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np
import shapely
from numpy.typing import NDArray
from pyproj import CRS, Transformer
from pyproj.enums import TransformDirection
from pyproj.exceptions import ProjError
from rasterio.transform import Affine
from rasterio.windows import Window

from spl_batch.constants import NODATA, QUANTUM_M
from spl_batch.errors import WorkflowError
from spl_batch.formats.crs import (
    LIBLAS_KEY,
    NAME,
    WKT_KEY,
    crs_name,
    crs_problems,
    horizontal,
    in_unit,
    parse_crs,
    same_crs,
    stretch_problem,
    vertical,
)
from spl_batch.formats.geotiff_keys import GEO_KEYS
from spl_batch.formats.heights import names_datum, same_heights, states_heights, with_heights_of
from spl_batch.formats.las.chunks import LASZIP_KEY, RecordReader
from spl_batch.formats.las.frame import Frame, preamble, wkt_vlr, write_laz
from spl_batch.formats.las.header import WKT_BIT, read_header
from spl_batch.formats.las.records import EXTRA_BYTES_KEY, HEIGHT, added, rescaled
from spl_batch.formats.rasters.geotiff import write_cog
from spl_batch.formats.rasters.parts import (
    BLOCK,
    cells_between,
    centres,
    opened,
    read_part,
    windows,
)
from spl_batch.formats.transformations import best_transformer
from spl_batch.formats.units import NAMES, Units

KEY: Final = "outputs.crs"

UNITS_KEY: Final = "outputs.units"

CELL_KEY: Final = "outputs.cell"

_CHUNK: Final = 500_000
"""Points that are converted at once [count]."""

_EDGE_POINTS: Final = 21
"""Points along an edge of a raster by which its extent elsewhere is found [count]."""

Coordinates = NDArray[np.float64]


class Reprojection:
    """From the CRS of a survey to one that a user names, or to the same in another unit.

    Heights change where both name a vertical CRS, or one of them the ellipsoid, but not that of one
    datum both; without one in the target they stay above what they are, in the survey's unit unless
    one is named. Another unit alone is an exact factor. What PROJ
    needs for it, a grid too, is asked for once points are moved or checked, not for the name.

    Parameters
    ----------
    survey : CRS or None
        Of what is delivered.
    text : str or None
        What PROJ takes as the target; by default the survey's CRS.
    unit : str or None
        Of all axes of the target, a key of :data:`~spl_batch.formats.units.NAMES`; by default as
        it has them.

    Raises
    ------
    WorkflowError
        If the survey has no CRS, the named one does not serve, or heights would have to be guessed.
    """

    def __init__(self, survey: CRS | None, text: str | None, unit: str | None = None) -> None:
        #: Key of the workflow that asks for it.
        self.key = KEY if text is not None else UNITS_KEY if unit is not None else CELL_KEY
        named = None if text is None else _named(text)
        if survey is None or not horizontal(survey).is_projected:
            raise WorkflowError(
                f"{self.key}: the survey has no CRS on earth: name it in survey.crs"
            )
        named = named or survey
        asked = named is not survey and states_heights(named)
        if asked and not names_datum(survey):
            raise WorkflowError(
                f"{KEY}: {crs_name(vertical(named) or named)} is named, and nothing states what "
                "the survey's heights are above: name it in survey.vertical_crs; from the "
                "ellipsoid to a geoid leads outputs.geoid"
            )
        kept = states_heights(survey) and not states_heights(named)
        whole = with_heights_of(named, survey) if kept else named
        self.crs = whole if unit is None else in_unit(whole, NAMES[unit])
        self._to, self._survey = Units.of(self.crs), survey
        #: Units of the target's heights in one of the survey's.
        self._ratio = Units.of(survey).vertical_m / self._to.vertical_m
        self._heights_too = states_heights(survey) and not _same_zero(survey, whole)

    @cached_property
    def _flat(self) -> Transformer:
        if self.key != KEY:
            # EPSG rounds the false origins of twins: by PROJ they lie up to 0.1 mm apart.
            factor = Units.of(self._survey).horizontal_m / self._to.horizontal_m
            return Transformer.from_pipeline(f"+proj=affine +s11={factor!r} +s22={factor!r}")
        return self._transformer(horizontal(self._survey), horizontal(self.crs))

    @cached_property
    def _whole(self) -> Transformer:
        return self._transformer(self._survey, self.crs)

    def _transformer(self, source: CRS, target: CRS) -> Transformer:
        try:
            return best_transformer(source, target)
        except ProjError as error:
            raise self._unreachable(str(error)) from None

    def _unreachable(self, reason: str) -> WorkflowError:
        return WorkflowError(
            f"{self.key}: cannot be reached from {crs_name(self._survey)} ({reason}): name another "
            "CRS, or give PROJ the grid that it lacks"
        )

    @property
    def moves_points(self) -> bool:
        """Whether clouds differ from those in the survey's CRS."""
        heights = self._heights_too or self._ratio != 1.0
        return heights or not same_crs(self._survey, self.crs)

    def in_units(self, length_m: float) -> float:
        """A length in metres, in the target's unit."""
        return length_m / self._to.horizontal_m

    def check(self, corners: Coordinates) -> None:
        """Refuse what PROJ cannot convert; ``corners``: those of the survey, (n, 3)."""
        try:
            moved = np.concatenate([self.coordinates(corner[None]) for corner in corners])
            flat = np.column_stack(self._flat.transform(*corners[:, :2].T))  # of rasters and tiles
        except ProjError as error:
            reason = str(error)
        else:
            if np.isfinite(moved).all() and np.isfinite(flat).all():
                if problem := stretch_problem(self.crs, self._to.metres(flat), NAME):
                    raise WorkflowError(f"{self.key}: {problem[0]}")
                return
            reason = "a corner of the survey has no coordinates there"
        raise self._unreachable(reason)

    def coordinates(self, xyz: Coordinates) -> Coordinates:
        """Coordinates, (n, 3), in the units of both CRS."""
        x, y, z = xyz.T
        if self._heights_too:
            return np.column_stack(self._whole.transform(x, y, z, errcheck=len(xyz) == 1))
        x, y = self._flat.transform(x, y)
        return np.column_stack([x, y, z * self._ratio])

    def shape(self, shape: shapely.Geometry) -> shapely.Geometry:
        """A shape with its vertices in the target, from the unit of the survey's CRS."""

        def moved(xy: Coordinates) -> Coordinates:
            return np.column_stack(self._flat.transform(*xy.T))

        return shapely.transform(shape, moved)

    def cloud(self, src: Path, dst: Path) -> int:
        """Write a delivered cloud to a thousandth of the unit, all dimensions kept; its points.

        Heights above ground are in the target's unit: our own by their values, an input's, in the
        unit of heights as well, by the scale that describes them.
        """
        header = read_header(src)
        dropped = {LASZIP_KEY, EXTRA_BYTES_KEY, WKT_KEY, LIBLAS_KEY, *GEO_KEYS}
        corners = self.coordinates(np.array([header.mins_m, header.maxs_m], np.float64))
        offsets = np.floor(corners.mean(axis=0) / 1000.0) * 1000.0 if header.n_points else [0.0] * 3
        offset_x, offset_y, offset_z = map(float, offsets)
        with RecordReader(header) as reader:
            ours = added(HEIGHT).descriptor
            above = [one.field for one in reader.layout.extra if one.descriptor == ours]
            extra = (
                rescaled(one, self._ratio)
                if one.name.startswith(HEIGHT) and one.descriptor != ours
                else one
                for one in reader.layout.extra
            )
            frame = Frame(
                preamble=preamble(header.raw, header.global_encoding | WKT_BIT),
                scales=(QUANTUM_M,) * 3,
                offsets=(offset_x, offset_y, offset_z),
                layout=replace(reader.layout, extra=tuple(extra)),
                vlrs=[*(v for v in header.vlrs if v.key not in dropped), wkt_vlr(self.crs)],
                evlrs=[(e, src) for e in header.evlrs if e.key not in dropped],
            )

            def chunks() -> Iterator[NDArray[Any]]:
                for start in range(0, header.n_points, _CHUNK):
                    given = reader.read(start, min(start + _CHUNK, header.n_points))
                    raw = np.column_stack([given[axis] for axis in "XYZ"])
                    records = given.copy()
                    xyz = raw * header.scales + header.offsets
                    frame.set_coordinates(records, self.coordinates(xyz), src)
                    for field in above:
                        records[field] *= np.float32(self._ratio)
                    yield records

            return write_laz(dst, frame, chunks())

    def raster(
        self, src: Path, dst: Path, *, cell: float, above_datum: bool, meaning: str, unit: str
    ) -> None:
        """Write a delivered raster again, bilinear between its cells, void where they are.

        Parameters
        ----------
        cell : float
            Edge of a cell, in the target's unit; its corners are multiples.
        above_datum : bool
            Whether its values are heights, not differences of such.
        meaning, unit : str
            As of :func:`~spl_batch.formats.rasters.geotiff.write_cog`; lengths in ``m``.
        """
        with opened(src) as source:
            (left, bottom, right, top), units = source.bounds, Units.of(self._survey)
            finer = source.transform.a * units.horizontal_m / (cell * self._to.horizontal_m)
        west, south, east, north = self._flat.transform_bounds(
            left, bottom, right, top, densify_pts=_EDGE_POINTS
        )
        column, last = cells_between(west / cell, east / cell)
        first, row = cells_between(south / cell, north / cell)
        shape = row - first, last - column
        corner = column * cell, row * cell

        def blocks() -> Iterator[tuple[int, int, NDArray[np.float32]]]:
            """Lengths in metres."""
            whole = Window(0, 0, shape[1], shape[0])
            for window in windows(whole, max(1, int(BLOCK * min(1.0, finer)))):
                x, y = (side.ravel() for side in centres(corner, cell, window))
                east_north = self._flat.transform(x, y, direction=TransformDirection.INVERSE)
                xy = np.column_stack(east_north)
                values = _sampled(src, units.metres(xy))
                if above_datum and self._heights_too:
                    known = np.isfinite(values)
                    xyz = np.column_stack([xy[known], values[known] / units.vertical_m])
                    values[known] = self.coordinates(xyz)[:, 2] * self._to.vertical_m
                kept = np.where(np.isnan(values), NODATA, values).astype(np.float32)
                yield window.row_off, window.col_off, kept.reshape(window.height, window.width)

        write_cog(
            dst,
            blocks(),
            shape=shape,
            transform=Affine(cell, 0.0, corner[0], 0.0, -cell, corner[1]),
            crs=self.crs.to_wkt(),
            description=meaning,
            unit=unit,
        )


def _named(text: str) -> CRS:
    """CRS that a user names as a target; WorkflowError where it is none for that."""
    named = parse_crs(text, KEY)
    faults = crs_problems(named, NAME)
    if not faults and not horizontal(named).is_projected:
        faults = [f"{crs_name(named)} is no CRS on earth"]
    if faults:
        raise WorkflowError("; ".join(f"{KEY}: {fault}" for fault in faults))
    return named


def _same_zero(survey: CRS, target: CRS) -> bool:
    """Whether heights that both state are in one unit above the same: a datum, or an ellipsoid."""
    mine, wanted = vertical(survey), vertical(target)
    if mine is not None and wanted is not None:
        return same_heights(mine, wanted)
    return mine is wanted and survey.datum == target.datum


def _sampled(path: Path, xy_m: Coordinates) -> Coordinates:
    """Values of a raster at points, (n,); NaN where it has none, or a point has no coordinates."""
    there, out = np.isfinite(xy_m).all(axis=1), np.full(len(xy_m), np.nan)
    if there.any():
        (west, south), (east, north) = (end(xy_m[there], axis=0) for end in (np.min, np.max))
        part = read_part(path, (west, south, east, north))
        if part is not None:
            out[there] = part.sampled(xy_m[there])
    return out
