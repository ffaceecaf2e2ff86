"""The scene file: a landscape, who flies over it, with which instrument.

Places are metres east and north of the scene's origin. All defaults are written here; an unknown
key is an error that names the nearest known one.
"""

import math
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
from pydantic import AfterValidator, Field, model_validator
from pyproj import CRS
from pyproj.exceptions import CRSError

from spl_batch.airborne.sensors.sensor import Sensor, load_preset
from spl_batch.airborne.simulate.scene.landscape import (
    Bridge,
    Buildings,
    NotNegative,
    Place,
    Share,
    Terrain,
    Trees,
    Water,
    Wires,
)
from spl_batch.engine.settings.base import Positive, Section
from spl_batch.engine.settings.workflow_file import validated
from spl_batch.engine.verbs.simulation import scene_of

MOST_TILES: Final = 400
"""Files of a delivery by tile, all of which are open while it is simulated [count]."""


def _projected(name: str) -> str:
    try:
        crs = CRS.from_user_input(name)
    except CRSError:
        raise ValueError(f"{name!r} is not a CRS that PROJ knows") from None
    if not crs.is_projected or crs.axis_info[0].unit_conversion_factor != 1.0:
        raise ValueError(f"{name!r} must be projected, in metres")
    return name


Projected = Annotated[str, AfterValidator(_projected)]


class Flight(Section):
    """One pass, straight and level."""

    heading_deg: float = Field(description="Clockwise from grid north [deg].")
    altitude_agl_m: Positive = Field(2500.0, description="Above the scene's mean ground [m].")
    speed_m_s: Positive = Field(85.0, description="Over ground [m/s].")
    offset_m: float = Field(0.0, description="To starboard of the scene's centre [m].")
    sky: Positive = Field(1.0, description="Sunlight relative to the scene's [1].")
    strip_offset_m: tuple[float, float, float] = Field(
        (0.0, 0.0, 0.0),
        description="East, north and up by which its recorded returns lie off, as where "
        "flightlines are not adjusted [m].",
    )
    gate_m: Positive | None = Field(None, description="Of its gate; the acquisition's without [m].")
    crs: Projected | None = Field(None, description="CRS of its file, where not the scene's.")


class Haze(Section):
    """A layer of air that sends light back, in patches that drift."""

    base_m: float = Field(60.0, description="Above the scene's mean ground [m].")
    top_m: float = Field(100.0, description="Above the scene's mean ground [m].")
    times_noise: Positive = Field(5.0, description="Returns at full strength / mean background.")
    cover: float = Field(0.5, gt=0, le=1, description="Share of the area under patches.")
    patch_m: Positive = Field(120.0, description="Shortest waves that patches are made of [m].")
    edge_m: NotNegative = Field(5.0, description="Over which base and top fade [m].")
    drift_m_s: Place = Field((0.0, 0.0), description="Wind towards east and north [m/s].")


class Fog(Section):
    """Air above the ground that sends light back, the less the higher."""

    times_noise: Positive = Field(30.0, description="Returns at the ground / mean background.")
    scale_m: Positive = Field(1.5, description="Height at which a third is left [m].")


class Sky(Section):
    """Sun and air [W17 Eq. 2.2-2.5]."""

    background_per_m3: Positive | None = Field(
        None,
        description="Background returns per cubic metre at the ground, all flightlines "
        "together; scales sun and dark current to it. Without it they follow from physics.",
    )
    irradiance_w_m2_nm: NotNegative = Field(1.84, description="Exoatmospheric [W/m2/nm].")
    zenith_deg: float = Field(45.0, ge=0, lt=88, description="Of the sun [deg].")
    azimuth_deg: float = Field(160.0, description="Of the sun, clockwise from north [deg].")
    by_albedo: bool = Field(
        False,
        description="Background of each beamlet and shot by what it looks at: reflectance, slope "
        "to the sun, cast shadows; one rate for all without.",
    )
    skylight: Share = Field(0.15, description="Of the light, from the sky where no sun shines.")
    brightest: float = Field(
        2.0, ge=1, description="Sunlight of a slope over that of level ground, at most [1]."
    )
    extinction_per_m: NotNegative = Field(1.0e-4, description="Atmospheric, at ground [1/m].")
    scale_height_m: Positive = Field(8000.0, description="Of the atmosphere [m].")
    variation: float = Field(0.3, ge=0, lt=1, description="Relative swing along a flightline.")
    period_s: Positive = Field(5.0, description="Of the swing [s].")
    gate_fall: float = Field(
        0.0, ge=-1, le=1, description="Background at the gate's start less end, over their sum."
    )
    haze: tuple[Haze, ...] = Field((), description="Layers of haze or cloud.")
    fog: tuple[Fog, ...] = Field((), description="Fog on the ground.")


class Acquisition(Section):
    """How the instrument was run, and what is wrong with it."""

    prf_hz: Positive = Field(60_000.0, description="Pulse repetition frequency [Hz].")
    gate_m: Positive = Field(300.0, description="Slant length of the range gate [m].")
    gate_above: float = Field(0.5, gt=0, lt=1, description="Share of the gate above ground.")
    gate_moves_s: float = Field(
        1.0, ge=0.25, description="Flight time over which the gate stands still [s]."
    )
    dead_channels: tuple[int, ...] = Field((), description="Channels that see nothing.")
    weak_channels: dict[int, Share] = Field({}, description="Channel: relative sensitivity.")
    gain_spread: float = Field(0.05, ge=0, lt=0.3, description="Of the channels' sensitivity.")
    wobble_deg: NotNegative = Field(0.2, description="Swing of roll and pitch [deg].")
    start_s: float = Field(371_000_000.0, description="Adjusted standard GPS time of take-off [s].")
    turn_s: Positive = Field(240.0, description="From the middle of one line to the next [s].")
    margin_m: NotNegative = Field(5.0, description="Shots this far outside are kept [m].")


class LagTail(Section):
    """Afterpulses that come later than by an exponential law."""

    share: Share = Field(0.4, description="Part of the afterpulses whose lag follows the tail.")
    scale_m: Positive = Field(4.0, description="Scale of the tail behind the dead time [m].")
    power: float | None = Field(
        None,
        gt=1,
        le=10,
        description="The density falls as (1 + lag / scale) to this power; exponential without.",
    )


class Detector(Section):
    """What the detector really does, where it differs from the workflow's sensor."""

    afterpulse_probability: float | None = Field(
        None, ge=0, lt=1, description="Afterpulses per detection; the sensor's without."
    )
    afterpulse_scale_m: Positive | None = Field(
        None, description="Mean lag behind the dead time [m]; the sensor's without."
    )
    afterpulse_lag_max_m: Positive | None = Field(
        None, description="Longest lag behind the parent [m]; the sensor's without."
    )
    tail: LagTail | None = Field(None, description="Afterpulses with a longer lag; none without.")
    range_sigma_m: Positive | None = Field(
        None, description="Ranging spread, one sigma [m]; the sensor's without."
    )


class Checkpoints(Section):
    """Points of a field survey, as far as the scene has room."""

    open: int = Field(40, ge=0, description="On open ground [count].")
    vegetated: int = Field(32, ge=0, description="Below crowns [count].")
    accuracy_m: Positive = Field(0.015, description="Vertical accuracy, one sigma [m].")
    open_below_m: NotNegative = Field(0.05, description="Highest cover of open ground [m].")
    vegetated_above_m: Positive = Field(2.0, description="Lowest cover of vegetated ground [m].")
    margin_m: NotNegative = Field(
        5.0, description="Distance to the scene's edge, water and houses, at least [m]."
    )


class Reference(Section):
    """Linear-mode cloud and checkpoints to compare with."""

    density_per_m2: Positive = Field(10.0, description="First returns [1/m2].")
    noise_m: NotNegative = Field(0.03, description="Spread of heights [m].")
    spot_m: Positive = Field(0.1, description="Spread of a pulse on the ground [m].")
    seen_through: Share = Field(
        0.15, description="Share of a pulse that is left where the ground is recorded, at least."
    )
    seen_wire: Share = Field(
        0.02, description="Share of a pulse that a wire catches where it is recorded, at least."
    )
    checkpoints: Checkpoints = Checkpoints()


class Delivery(Section):
    """How the returns are handed over."""

    tile_m: Positive | None = Field(
        None,
        description="Edge of the tiles that files hold; without it a file is a flightline [m].",
    )
    point_source_id: bool = Field(
        True, description="Whether points name their flightline; 0 in all files if not."
    )
    channel_dimension: Literal["channel", "user_data"] = Field(
        "channel", description="LAS dimension with the beamlet, from 1."
    )
    scale_m: Positive = Field(0.001, description="Unit of the coordinates [m].")
    trajectory_hz: Positive = Field(200.0, description="Records of the trajectory [Hz].")
    aoi: bool = Field(False, description="Whether the scene's extent comes as area of interest.")


class Scene(Section):
    """A survey to be simulated."""

    kind: Literal["imaging"] = Field("imaging", description="Airborne single-photon lidar.")
    name: str = Field("scene", description="Title of the survey.")
    crs: Projected = Field("EPSG:32615", description="Projected CRS in metres.")
    origin_m: tuple[float, float, float] = Field(
        (272_000.0, 3_290_000.0, 40.0), description="South-west corner; mean ground height [m]."
    )
    extent_m: tuple[Positive, Positive] = Field(description="East-west, north-south [m].")
    seed: int = Field(1, ge=0, description="Everything random follows from it.")
    terrain: Terrain = Terrain()
    buildings: Buildings = Buildings()
    trees: Trees = Trees()
    wires: tuple[Wires, ...] = ()
    bridges: tuple[Bridge, ...] = ()
    water: tuple[Water, ...] = ()
    flights: tuple[Flight, ...] = Field(min_length=1, description="Flightlines in flown order.")
    sensor: str | Sensor = Field("spl100", description="A preset's name, or a mapping.")
    sensor_overrides: dict[str, Any] = Field({}, description="Sensor keys that differ from it.")
    detector: Detector = Detector()
    sky: Sky = Sky()
    acquisition: Acquisition = Acquisition()
    reference: Reference = Reference()
    delivery: Delivery = Delivery()

    @model_validator(mode="after")
    def _consistent(self) -> "Scene":
        if self.delivery.tile_m is not None and any(flight.crs for flight in self.flights):
            raise ValueError("flights: crs is that of a file, which tile_m shares; leave one out")
        instrument = self.instrument
        if instrument.array_columns**2 != instrument.beamlets:
            raise ValueError("sensor: beamlets must be array_columns squared")
        longest = self.detector.afterpulse_lag_max_m
        if longest is not None and longest <= instrument.dead_m:
            dead = f"{instrument.dead_m:.3f} m"
            raise ValueError(f"detector: afterpulse_lag_max_m must exceed the dead time, {dead}")
        used = {*self.acquisition.dead_channels, *self.acquisition.weak_channels}
        upside_down = [k for k, haze in enumerate(self.sky.haze) if haze.top_m <= haze.base_m]
        if upside_down:
            raise ValueError(f"sky: haze.{upside_down[0]}: top_m must be above base_m")
        tile_m = self.delivery.tile_m or math.inf
        if math.prod(size / tile_m + 1 for size in self.extent_m) > MOST_TILES:
            raise ValueError(
                f"delivery: tile_m makes more than {MOST_TILES} files; choose larger tiles"
            )
        outside = sorted(c for c in used if not 1 <= c <= instrument.beamlets)
        if outside:
            raise ValueError(f"acquisition: channels are 1..{instrument.beamlets}, not {outside}")
        return self

    def gate_of(self, flight: Flight) -> float:
        """Length of a flightline's range gate [m]."""
        return self.acquisition.gate_m if flight.gate_m is None else flight.gate_m

    def chance(self, *keys: int) -> np.random.Generator:
        """Random numbers of their own for one purpose."""
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=keys))

    @cached_property
    def instrument(self) -> Sensor:
        """The sensor, overrides put in."""
        base = load_preset(self.sensor) if isinstance(self.sensor, str) else self.sensor
        return Sensor.model_validate({**base.model_dump(), **self.sensor_overrides})


def parse_scene(content: Mapping[str, Any], where: str) -> Scene:
    """Check a scene's content; a WorkflowError lists every fault in one line."""
    return validated(Scene, content, where)


def load_scene(path: Path) -> Scene:
    """Read a scene file.

    Raises
    ------
    WorkflowError
        If the file cannot be read, is not YAML, or has a fault.
    """
    return scene_of(Scene, path)


def preset_scene(name: str) -> Scene:
    """Scene that ships with the project: ``quickstart`` or ``tiny``."""
    return load_scene(Path(__file__).parents[1] / "presets" / f"{name}.yaml")
