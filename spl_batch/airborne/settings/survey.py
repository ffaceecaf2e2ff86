"""What was flown, how it is cut into work, and what is written."""

from collections.abc import Iterator
from typing import Final, Literal, Self

from pydantic import Field, field_validator, model_validator

from spl_batch.airborne.sensors.sensor import Sensor
from spl_batch.engine.settings.base import Edge, Positive, Section, StoreSettings

PRF_HZ: Final = (1e3, 1e6)
"""Pulse rates of airborne lidars lie well within; a slip of kHz or MHz does not [Hz]."""


SPDX: Final = r"[\w.+-]+"
"""Pattern of a licence's identifier, as STAC takes it."""


def _in_hertz(prf_hz: float | None) -> None:
    """Refuse a pulse rate in another unit."""
    if prf_hz is not None and not PRF_HZ[0] <= prf_hz <= PRF_HZ[1]:
        raise ValueError(
            f"{prf_hz:g} Hz is no pulse rate of an airborne lidar, which lies from "
            f"{PRF_HZ[0]:g} to {PRF_HZ[1]:g} Hz; write hertz, 30 kHz is 30000"
        )


class SurveySettings(Section):
    """What was flown and where its files are."""

    name: str = Field("survey", description="Title of the report.")
    crs: str | None = Field(None, description="CRS for LAS files that carry none, e.g. EPSG:32615.")
    vertical_crs: str | None = Field(
        None,
        description="Vertical CRS of the heights, where the files name none, e.g. "
        "EPSG:5703: clouds, rasters and catalogues get a compound CRS. No height changes.",
    )
    flightlines: str | tuple[str, ...] = Field(
        description="LAS, LAZ or COPC files: a path or glob, or several, relative to this file."
    )
    trajectory: str | tuple[str, ...] | None = Field(
        None, description="CSV (gps_time,x,y,z), Parquet or SBET; a path or glob, or several."
    )
    trajectory_crs: str | None = Field(
        None,
        description="CRS of the trajectory; SBET defaults to EPSG:4979, others to the survey's.",
    )
    sensor: str | Sensor = Field("spl100", description="A preset's name, or a mapping.")
    channel_dimension: str | None = Field(
        None, description="LAS dimension with the beamlet number; without it a shot is one beamlet."
    )
    gap_s: Positive = Field(60.0, description="A pause that starts another lift [s].")
    align: Literal["none", "vertical"] = Field(
        "none",
        description="vertical: shift the heights of flightlines so that those that overlap fit.",
    )
    organisation: str | None = Field(
        None, min_length=1, description="Who delivers the results, for catalogue and report."
    )
    contact: str | None = Field(
        None, min_length=1, description="Person or address to ask, for catalogue and report."
    )
    licence: str | None = Field(
        None,
        pattern=rf"^({SPDX}|https?://\S+)$",
        description="Licence of the results, for catalogue and report: an identifier of SPDX "
        "such as CC-BY-4.0, or a URL.",
    )

    @field_validator("sensor")
    @classmethod
    def _prf_in_hertz(cls, sensor: str | Sensor) -> str | Sensor:
        if isinstance(sensor, Sensor):
            _in_hertz(sensor.prf_hz)
        return sensor


class ReferenceSettings(Section):
    """What the results are compared with: linear-mode lidar, checkpoints of a field survey."""

    points: str | tuple[str, ...] | None = Field(
        None, description="LAS/LAZ with ground class 2, building 6."
    )
    crs: str | None = Field(
        None, description="CRS for reference files that carry none, or none of heights."
    )
    remove_bias: bool = Field(
        False, description="Subtract the median difference before the statistics."
    )
    checkpoints: str | None = Field(
        None,
        description="Checkpoints for a statement of accuracy: CSV with id,x,y,z,surface,accuracy_m "
        "and, if need be, crs; or points of any vector format with these fields. surface: open or "
        "vegetated; accuracy_m: the checkpoint's own.",
    )
    checkpoints_crs: str | None = Field(
        None,
        description="CRS of checkpoints that state none, or none of heights; by default the "
        "survey's.",
    )
    checkpoints_accuracy_m: Positive | None = Field(
        None, description="Vertical accuracy of checkpoints that state none, one sigma [m]."
    )

    @model_validator(mode="after")
    def _names_something(self) -> Self:
        if self.points is None and self.checkpoints is None:
            raise ValueError("names neither points nor checkpoints; name one, or leave it out")
        return self


class TilingSettings(Section):
    """How space is cut for storage and work; results never depend on it."""

    tile_m: Edge = Field(100.0, description="Edge of a storage tile [m].")
    block_tiles: int | None = Field(
        None, ge=1, description="Tiles along one side of a work block; by default as memory allows."
    )


class AcquisitionSettings(Section):
    """What the instrument did; estimated from the data and reported where missing."""

    prf_hz: Positive | None = Field(None, description="Pulse repetition frequency [Hz].")
    gate_m: Positive | None = Field(None, description="Slant length of the range gate [m].")

    @field_validator("prf_hz")
    @classmethod
    def _prf_in_hertz(cls, prf_hz: float | None) -> float | None:
        _in_hertz(prf_hz)
        return prf_hz


class GeoidSettings(Section):
    """A geoid that terrain and surface are given above as well."""

    grid: str = Field(
        description="Grid of its heights above the ellipsoid of the survey's CRS: a name that PROJ "
        "knows, or a path relative to this file."
    )
    crs: str | None = Field(
        None,
        description="Vertical CRS of heights above it, in the unit of heights, e.g. EPSG:5703.",
    )


class ClientTileSettings(Section):
    """Tiles that a client names by polygons: clouds and rasters are cut by them."""

    polygons: str = Field(
        description="Polygons of the tiles, any vector format, a feature for each."
    )
    name: str = Field(
        "name", min_length=1, description="Field of that file with the names of the tiles."
    )
    format: Literal["laz", "copc"] = Field("laz", description="Format of their clouds.")


class OutputSettings(StoreSettings):
    """What is written beside the classified clouds."""

    diagnostics: bool = Field(False, description="Extra bytes noise_density and p_value.")
    classes: Literal["all", "noise"] = Field(
        "all",
        description="Classes of delivered points: all; or noise, where a signal point keeps the "
        "class that the input gave it.",
    )
    drop: tuple[Literal["noise", "withheld", "outside"], ...] = Field(
        (),
        description="Points that delivered clouds are without, counted in the report: noise of "
        "classes 7 and 18, those with the flag withheld, those outside aoi.",
    )
    height_above_ground: bool = Field(
        False,
        description="Extra bytes HeightAboveGround: height of each point above dtm.tif.",
    )
    tiles: Literal["none", "laz", "copc"] = Field("none", description="Points by tile as well.")
    client_tiles: ClientTileSettings | None = Field(
        None,
        description="Clouds and rasters cut by a client's polygons, in the folder client_tiles.",
    )
    contour_interval: Positive | None = Field(
        None,
        description="Contours of the terrain in contours.gpkg, so far apart in the unit of "
        "dtm.tif; by default none.",
    )
    geoid: GeoidSettings | None = Field(
        None,
        description="Where heights are above the ellipsoid: dtm_geoid.tif and dsm_geoid.tif, "
        "heights above a geoid.",
    )
    copc: bool = Field(
        False, description="Each classified cloud once more as COPC, in the folder copc."
    )
    crs: str | None = Field(
        None,
        description="CRS in which clouds and rasters are written once more, in the folder "
        "reprojected, e.g. EPSG:6344+5703; with a vertical part heights are transformed as well.",
    )
    units: Literal["m", "ft", "us-ft"] | None = Field(
        None,
        description="Unit of the axes of that CRS, heights too: metres, international or US "
        "survey feet; without crs, clouds and rasters are written once more in the survey's CRS "
        "with this unit. Report and screen show it. By default each CRS has its own.",
    )
    cell: Positive | None = Field(
        None,
        description="Edge of a raster cell there, in that unit, such as 3 for 3 feet; by default "
        "products.cell_m. Without crs and units, rasters alone are written once more.",
    )
    catalogue: bool = Field(
        True,
        description="STAC catalogue, virtual point cloud, index.gpkg.",
    )

    def remarks(self) -> Iterator[str]:
        """What has no effect beside other settings."""
        if self.client_tiles is None or self.crs is None:
            return
        asked = [f"outputs.{key}" for key in ("crs", "units", "cell") if getattr(self, key)]
        yield (
            f"{' and '.join(asked)}: without effect on client_tiles, which are in the survey's "
            "CRS, as their polygons are, with raster cells of products.cell_m"
        )
