"""The workflow file: one model of every setting, from which ``schemas/`` is generated.

Each default is written here and nowhere else, each key has its unit in its name or in
its description, and an unknown key is an error that names the nearest known one.
"""

import difflib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from spl_batch.errors import WorkflowError
from spl_batch.sensor import Sensor, load_preset

Positive = Annotated[float, Field(gt=0)]
Share = Annotated[float, Field(gt=0, lt=1)]


class Section(BaseModel):
    """Base of every part of the workflow: frozen, and strict about its keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class SurveySettings(Section):
    """What was flown and where its files are."""

    name: str = Field("survey", description="Title of the report.")
    crs: str | None = Field(None, description="CRS for LAS files that carry none, e.g. EPSG:32615.")
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


class ReferenceSettings(Section):
    """Linear-mode lidar that the results are compared with."""

    points: str | tuple[str, ...] = Field(description="LAS/LAZ with ground class 2, building 6.")
    crs: str | None = Field(None, description="CRS for reference files that carry none.")
    remove_bias: bool = Field(
        False, description="Subtract the median difference before the statistics."
    )


class TilingSettings(Section):
    """How space is cut for storage and work; results never depend on it."""

    tile_m: Positive = Field(100.0, description="Edge of a storage tile [m].")
    block_tiles: int | None = Field(
        None, ge=1, description="Tiles along one side of a work block; by default as memory allows."
    )


class AcquisitionSettings(Section):
    """What the instrument did; estimated from the data and reported where missing."""

    prf_hz: Positive | None = Field(None, description="Pulse repetition frequency [Hz].")
    gate_m: Positive | None = Field(None, description="Slant length of the range gate [m].")


class NoiseSettings(Section):
    """Line noise density and the voxel-spherical model [W17 5.2.1, W18 2.2.2]."""

    interval_shots: int = Field(60, ge=1, description="Shots counted together [count].")
    smooth_intervals: int = Field(
        40, ge=0, description="Half-width of the smoothing over intervals [count]; 0 is none."
    )
    peak_m: Positive = Field(
        5.0, description="Height window whose fullest place marks the signal [m]."
    )
    buffer_m: Positive = Field(50.0, description="Half-height around the signal left out [m].")
    voxel_m: Positive = Field(10.0, description="Edge of a noise voxel [m].")
    correction: Literal["seen", "published"] = Field(
        "seen", description="Silent beamlets: by seen fraction, or the published gamma."
    )


class FilterSettings(Section):
    """Which points are background noise [W18 2.2.3]."""

    method: Literal["vsaes", "none"] = Field("vsaes", description="Filter; none keeps every point.")
    test: Literal["tail", "published"] = Field(
        "tail", description="The corrected tail with links, or the published rule at 95 %."
    )
    alpha: Share = Field(0.001, description="Largest share of pure noise to be kept by the tail.")
    selection: float = Field(
        20.0,
        ge=1,
        description="Divides alpha: an ellipsoid is fitted to the very points that it counts.",
    )
    weak_alpha: Share = Field(
        0.05, description="Significance that suffices near strongly significant points."
    )
    link_m: float = Field(6.0, ge=0, le=40, description="Strong points are sought within [m].")
    link_count: int = Field(
        4, ge=0, description="Strong points that let a weak one live [count]; 0 is no linking."
    )
    peer_ratio: float = Field(
        2.0,
        ge=1,
        description="Neighbours whose spacing is smaller than the point's by more than this "
        "factor are not counted.",
    )
    spacing_neighbours: int = Field(
        6, ge=1, le=64, description="Spacing is the distance to this neighbour [count]."
    )
    spacing_cap_m: Positive = Field(3.0, le=40, description="Largest spacing told apart [m].")
    neighbours: int = Field(
        15, ge=4, le=64, description="Neighbours whose spread shapes the ellipsoid."
    )
    radius_m: Positive = Field(1.5, description="Radius of the sphere of equal volume [m].")
    axis_power: Literal["eigenvalue", "root"] = Field(
        "eigenvalue", description="Semi-axes follow the eigenvalues [W18] or their roots."
    )
    eigen_floor_m: Positive = Field(0.03, description="Smallest spread along an axis [m].")
    axis_cap_m: Positive = Field(12.0, description="Longest semi-axis [m].")
    neighbour_cap_m: Positive = Field(12.0, le=40, description="Farthest neighbour looked for [m].")


class AfterpulseSettings(Section):
    """Afterpulse candidates [W17 ch. 7]."""

    enabled: bool = Field(True, description="Look for afterpulses.")
    coarse_bin_m: Positive = Field(30.0, description="DCC coarse range bin [m].")
    fine_bin_m: Positive = Field(5.0, description="DCC fine range bin [m].")
    weight_min: Share = Field(0.1, description="Bisquare weight that marks the hard surface.")
    fit_p68_max_m: Positive = Field(0.5, description="A fit is trusted below this [m].")
    below_plane_m: Positive = Field(
        0.3, description="Returns farther below the plane are flagged [m]."
    )
    lag_max_m: Positive = Field(5.0, description="Longest lag behind a parent or plane [m].")


class PtdSettings(Section):
    """Progressive TIN densification [Axelsson 2000; W17 7.4]."""

    seed_cell_m: Positive = Field(2.0, description="Grid of the first ground points [m].")
    seed_slope: Positive = Field(
        0.2, description="Slope tolerance of the opening that seeds survive [rise/run]."
    )
    seed_step_m: Positive = Field(
        3.0, description="Fall between two windows that is an object's at any slope [m]."
    )
    object_m: Positive = Field(60.0, description="Widest object that seeds avoid [m].")
    terrain_angle_deg: Positive = Field(88.0, le=90, description="Steepest terrain [deg].")
    iteration_angle_deg: Positive = Field(
        10.0, lt=90, description="Largest angle to a facet [deg]."
    )
    iteration_distance_m: Positive = Field(1.4, description="Largest distance to a facet [m].")
    spread_m: float = Field(
        0.15, ge=0, description="Part of a distance that ranging noise explains [m]."
    )
    node_m: Positive = Field(
        1.0, description="Grid of candidates [m]; twice that below two points in a cell."
    )
    layer_m: Positive = Field(0.3, description="Thickness of the lowest layer in a cell [m].")
    band_m: Positive = Field(0.2, description="Ground within this distance of the surface [m].")


class SmrfSettings(Section):
    """Simple morphological filter [Pingel, Clarke & McBride 2013]."""

    cell_m: Positive = Field(1.0, description="Grid of minimum heights [m].")
    slope: Positive = Field(0.15, description="Slope tolerance [rise/run].")
    window_m: Positive = Field(30.0, description="Radius of the largest window [m].")
    threshold_m: Positive = Field(0.5, description="Height above the surface [m].")
    scalar: float = Field(1.25, ge=0, description="Growth of the threshold with slope [m].")
    layer_m: Positive = Field(0.3, description="Thickness of the lowest layer in a cell [m].")


class GroundSettings(Section):
    """Ground points; run on fixed absolute cells, so that tiles cannot matter."""

    method: Literal["ptd", "smrf"] = Field("ptd", description="Ground filter.")
    cell_m: Positive = Field(200.0, description="Edge of a ground cell [m].")
    buffer_m: Positive = Field(60.0, description="Points around a cell that take part [m].")
    ptd: PtdSettings = PtdSettings()
    smrf: SmrfSettings = SmrfSettings()


class ProductSettings(Section):
    """Rasters."""

    cell_m: Positive = Field(1.0, description="Edge of a raster cell [m].")
    void_max_m: Positive = Field(
        20.0, description="Farthest ground point that a DTM cell may use [m]."
    )
    dsm_void_max_m: float = Field(3.0, ge=0, description="Farthest DSM cell that fills a void [m].")
    dsm_near_m: Positive = Field(
        0.5, description="Smallest sphere in which returns confirm a DSM cell [m]."
    )
    dsm_support_m: Positive = Field(
        1.5, le=20, description="Largest such sphere, for thin crowns [m]."
    )
    dsm_support: int = Field(
        1, ge=0, description="Returns that confirm a DSM cell, at the least [count]."
    )
    dsm_false_alarm: Share = Field(
        1e-7, description="Chance that noise alone confirms a noise return, by Poisson's law."
    )
    dsm_peer_ratio: float = Field(
        1.5,
        ge=1,
        description="Returns whose spacing is smaller than a DSM cell's by more than this "
        "factor do not confirm it.",
    )
    dsm_spacing_neighbours: int = Field(
        3, ge=1, le=64, description="That spacing is the distance to this neighbour [count]."
    )


class OutputSettings(Section):
    """What is written beside the classified clouds."""

    diagnostics: bool = Field(False, description="Extra bytes noise_density and p_value.")
    tiles: Literal["none", "laz", "copc"] = Field("none", description="Points by tile as well.")


class Workflow(Section):
    """Everything that a run needs to know."""

    survey: SurveySettings
    reference: ReferenceSettings | None = None
    output: str = Field(description="Folder of the results, relative to this file.")
    tiling: TilingSettings = TilingSettings()
    acquisition: AcquisitionSettings = AcquisitionSettings()
    noise: NoiseSettings = NoiseSettings()
    filter: FilterSettings = FilterSettings()
    afterpulse: AfterpulseSettings = AfterpulseSettings()
    ground: GroundSettings = GroundSettings()
    products: ProductSettings = ProductSettings()
    outputs: OutputSettings = OutputSettings()
    water: str | None = Field(None, description="Polygons of water, any vector format.")
    aoi: str | None = Field(None, description="Polygons of the area of interest.")

    @property
    def sensor(self) -> Sensor:
        """The instrument, with the acquisition's own PRF and gate put in."""
        chosen = self.survey.sensor
        sensor = load_preset(chosen) if isinstance(chosen, str) else chosen
        given = self.acquisition.model_dump(exclude_none=True)
        return sensor.model_copy(update=given)


def parse_workflow(content: Mapping[str, Any], where: str) -> Workflow:
    """Check a workflow's content.

    Parameters
    ----------
    content : mapping
        Parsed YAML.
    where : str
        What messages call it: the file's path.

    Raises
    ------
    WorkflowError
        One line that lists every fault.
    """
    try:
        workflow = Workflow.model_validate(content)
    except ValidationError as error:
        faults = "; ".join(_fault(e) for e in error.errors(include_url=False))
        raise WorkflowError(f"{where}: {faults}") from None
    workflow.sensor  # noqa: B018 - an unknown preset is a fault of the file, found here
    return workflow


def load_workflow(path: Path, overrides: Sequence[str] = ()) -> Workflow:
    """Read a workflow file.

    Parameters
    ----------
    path : Path
        YAML file.
    overrides : sequence of str
        ``key.path=value``, value parsed as YAML; applied in order.

    Raises
    ------
    WorkflowError
        If the file cannot be read, is not YAML, or has a fault.
    """
    content = read_mapping(path, "a workflow is a mapping with survey: and output:")
    for override in overrides:
        _apply(content, override)
    return parse_workflow(content, str(path))


def read_mapping(path: Path, otherwise: str) -> dict[str, Any]:
    """Content of a YAML file that holds a mapping.

    Parameters
    ----------
    path : Path
        YAML file.
    otherwise : str
        What is said when it holds something else.

    Raises
    ------
    WorkflowError
        If the file cannot be read, is not YAML, or holds no mapping.
    """
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise WorkflowError(f"{path}: cannot be read: {error.strerror}") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        reason = " ".join(str(error).split())
        raise WorkflowError(f"{path}: not valid YAML: {reason}") from None
    if not isinstance(content, dict):
        raise WorkflowError(f"{path}: {otherwise}")
    return content


def _apply(content: dict[str, Any], override: str) -> None:
    key, equals, text = override.partition("=")
    if not equals or not key:
        raise WorkflowError(f"--set {override}: write key.path=value")
    *parents, last = key.split(".")
    node = content
    for parent in parents:
        if node.get(parent) is None:
            node[parent] = {}
        child = node[parent]
        if not isinstance(child, dict):
            raise WorkflowError(f"--set {override}: {parent} is a value, not a section")
        node = child
    try:
        node[last] = yaml.safe_load(text)
    except yaml.YAMLError:
        raise WorkflowError(
            f"--set {override}: the value is not valid YAML; quote it: key='*.laz'"
        ) from None


def _fault(error: Any) -> str:
    place = ".".join(str(part) for part in error["loc"])
    if error["type"] == "extra_forbidden":
        # pydantic names the member of a union on the way, as in survey.sensor.Sensor.prf.
        near = _nearest([str(p) for p in error["loc"] if p != "Sensor"])
        return f"{place}: no such key; the nearest known key is {near!r}"
    given = error.get("input")
    shown = "" if isinstance(given, dict) else f" (found {given!r})"
    return f"{place}: {error['msg'][0].lower()}{error['msg'][1:]}{shown}"


def _nearest(place: Sequence[str]) -> str:
    """Known key most like an unknown one, those of its own section first."""
    known = _keys(Workflow)
    own = [key for key in known if key[:-1] == tuple(place[:-1])]
    for keys, cutoff in ((own, 0.6), (known, 0.0)):
        near = difflib.get_close_matches(place[-1], [key[-1] for key in keys], n=1, cutoff=cutoff)
        if near:
            return ".".join(next(key for key in keys if key[-1] == near[0]))
    return ""


def _keys(model: type[BaseModel], above: tuple[str, ...] = ()) -> list[tuple[str, ...]]:
    """Path of every key of a section and of those below it."""
    found: list[tuple[str, ...]] = []
    for name, field in model.model_fields.items():
        found.append((*above, name))
        for part in (field.annotation, *get_args(field.annotation)):
            if isinstance(part, type) and issubclass(part, BaseModel):
                found += _keys(part, (*above, name))
    return found
