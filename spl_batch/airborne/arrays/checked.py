"""What a caller's arrays must be, and the table that the survey's steps take.

Metres become whole numbers on the lattice of :data:`~spl_batch.constants.QUANTUM_M`, as the points
of a file do. All faults are reported at once: which array, which value, what helps.
"""

from collections.abc import Mapping
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spl_batch.airborne.settings.workflow import Workflow, parse_workflow
from spl_batch.constants import QUANTA_PER_M
from spl_batch.engine.flow.cluster import machine_memory
from spl_batch.engine.plan.worker_memory import LOADED_BASE_BYTES, USABLE_SHARE, usable_bytes
from spl_batch.errors import InputError, WorkflowError, counted, grouped
from spl_batch.formats.crs import look_like_degrees
from spl_batch.formats.gps_clock import usable_times
from spl_batch.lattice.tables import PointFlag, PointTable
from spl_batch.lattice.tiles import Bounds

HIGHEST_M: Final = 1e6
"""Heights are metres above some ground: a larger number is another unit, or another axis [m]."""

FARTHEST_M: Final = 1e9
"""The same of eastings and northings [m]."""

COARSE_M: Final = 0.01
"""Coordinates that are held in coarser steps have lost what a filter and a terrain need [m]."""

MOST_PER_M3: Final = 100.0
"""Noise that an array may state, a thousand times that of bright daylight: the time that counting
takes grows with it [1/m3]."""

MOST_OF_A_SHOT: Final = 10_000
"""Returns of one time above which it is no shot's: 100 beamlets return some hundreds [count]."""

FEWEST: Final = 10
"""Points below which degrees are as likely as metres: the box around them is small either way."""

Numbers = NDArray[Any]


def settings_of(
    sections: Mapping[str, Any] | None, sensor: Any = "spl100", **named: Mapping[str, Any]
) -> Workflow:
    """Settings by the sections of a workflow file that arrays have a use for, and the instrument.

    ``named``: keys of sections that have an argument of their own; None leaves them as they are.
    Raises WorkflowError if a section or key is unknown, or a value is wrong.
    """
    given = dict(sections or {})
    for section, keys in named.items():
        chosen = {key: value for key, value in keys.items() if value is not None}
        given |= {section: {**given.get(section, {}), **chosen}} if chosen else {}
    known = {"filter", "noise", "afterpulse", "acquisition", "ground", "products"}
    if unknown := sorted(set(given) - known):
        raise WorkflowError(
            f"settings: {', '.join(unknown)}: arrays take the sections {', '.join(sorted(known))}"
        )
    if not isinstance(sensor, (str, Mapping)):
        sensor = sensor.model_dump(exclude_none=True)
    survey = {"flightlines": "arrays", "sensor": sensor}
    return parse_workflow({"survey": survey, "output": "none", **given}, "settings")


class Asked(NamedTuple):
    """What the values of an array have to be, one for each point."""

    dtype: Any
    meaning: str
    most: float | None = None  #: None if any value will do, else they are 0 to this.
    shape: tuple[int, ...] = ()  #: Of one value.


ASKED: Final[Mapping[str, Asked]] = {
    "gps_time": Asked(np.float64, "a time [s]"),
    "channel": Asked(np.uint8, "a beamlet number from 0 to 255", 255),
    "return_number": Asked(np.uint8, "a whole number from 0 to 255", 255),
    "flightline": Asked(np.uint16, "a whole number from 0 to 65535", 65_535),
    "beam_origin": Asked(np.float64, "the sensor's position, three numbers [m]", shape=(3,)),
    "noise_density": Asked(
        np.float64, f"returns per cubic metre, 0 to {MOST_PER_M3:g}", MOST_PER_M3
    ),
    "water": Asked(np.bool_, "true or false"),
    "ground": Asked(np.bool_, "true or false"),
    "labels": Asked(np.uint8, "a noise class from 0 to 255, or whether it is signal", 255),
}
"""Arrays that a caller may give beside the coordinates."""


def values_of(name: str, given: ArrayLike, count: int) -> Numbers:
    """Values of a caller's array for each of some points; a single one is for all.

    Raises InputError if its shape is wrong, or a value.
    """
    asked, found = ASKED[name], np.asarray(given)
    if found.shape not in {asked.shape, (count, *asked.shape)}:
        raise InputError(
            name,
            f"has shape {found.shape}; give {asked.meaning}, one for each of {count} points or for "
            "all",
        )
    if found.dtype.kind not in "biuf":
        # None becomes NaN, as in any array of numbers.
        try:
            found = found.astype(np.float64)
        except (TypeError, ValueError) as fault:
            raise InputError(name, f"holds no numbers; give {asked.meaning}") from fault
    if asked.most is not None:
        # A comparison with NaN is false.
        fits = (found >= 0) & (found <= asked.most)
        if np.issubdtype(asked.dtype, np.integer):
            fits &= found == np.rint(found)
        bad = np.flatnonzero(~fits)
        if len(bad):
            value = found.reshape(-1)[bad[0]]
            raise InputError(name, f"{value:g} (number {bad[0]}); give {asked.meaning}")
    each = np.broadcast_to(found.astype(asked.dtype, copy=False), (count, *asked.shape))
    return np.ascontiguousarray(each)


def points_of(xyz: ArrayLike, **arrays: ArrayLike | None) -> PointTable:
    """Points [m] as a table in the caller's order, with further columns by :data:`ASKED`.

    Raises InputError if a shape is wrong, a coordinate is no place, or a value.
    """
    if hasattr(xyz, "xyz"):
        raise InputError("xyz", f"a {type(xyz).__name__}, and no array; give its attribute xyz")
    place = np.asarray(xyz)
    if place.ndim != 2 or place.shape[1] != 3 or place.dtype.kind not in "fiu":
        raise InputError(
            "xyz",
            f"an array of shape {place.shape}, {place.dtype}; give (n, 3) numbers: easting, "
            "northing, height in metres",
        )
    misplaced = _misplaced(place)
    wrong = [InputError("xyz", misplaced)] if misplaced else []
    held: dict[str, Numbers] = {"water": np.zeros(len(place), np.bool_)}
    for name, given in arrays.items():
        if given is not None:
            try:
                held[name] = values_of(name, given, len(place))
            except InputError as fault:
                wrong.append(fault)
    if wrong:
        raise wrong[0] if len(wrong) == 1 else InputError("arrays", [*map(str, wrong)])
    whole = np.rint(place.astype(np.float64, copy=False) * QUANTA_PER_M).astype(np.int64)
    flags = held.pop("water") * np.uint8(PointFlag.WATER)
    held = {"point_source_id" if name == "flightline" else name: v for name, v in held.items()}
    base = dict(zip("xyz", whole.T, strict=True))
    return PointTable({}).with_columns(**base, flags=flags, **held)


def _misplaced(place: Numbers) -> list[str]:
    """What is wrong with coordinates; longitudes and latitudes a run refuses as well."""
    faults = []
    bad = np.flatnonzero(~np.isfinite(place).all(axis=1))
    if len(bad):
        faults.append(
            f"{counted(len(bad), 'points')} not finite, the first is number {bad[0]}; "
            "leave such out"
        )
    limits = np.array([FARTHEST_M, FARTHEST_M, HIGHEST_M])
    far = np.flatnonzero(
        (np.abs(np.nan_to_num(place, posinf=0.0, neginf=0.0)) > limits).any(axis=1)
    )
    if len(far):
        value = ", ".join(f"{v:g}" for v in place[far[0]])
        faults.append(f"point number {far[0]} lies at {value}; give metres in a projected CRS")
    few = len(place) < FEWEST
    if not faults and not few and look_like_degrees(place.min(0).tolist(), place.max(0).tolist()):
        faults.append(
            "the coordinates look like degrees; reproject to metres, with pyproj for instance, or "
            "add 1000 to x where they are metres from a corner of your own"
        )
    return faults


def box_of(table: PointTable) -> Bounds:
    """Region of all points of a table, at least one [quanta]."""
    x, y = table["x"], table["y"]
    return Bounds(int(x.min()), int(y.min()), int(x.max()) + 1, int(y.max()) + 1)


def require_shots(gps_time: NDArray[np.float64]) -> None:
    """Refuse times none of which is finite, or one of which holds more returns than a shot can."""
    times, counts = np.unique(gps_time[usable_times(gps_time)], return_counts=True)
    remedy = "leave it out, and the noise is measured where the cloud is empty"
    if len(gps_time) and not len(times):
        raise InputError("gps_time", f"no time is usable; {remedy}")
    if len(times) and counts[most := int(counts.argmax())] > MOST_OF_A_SHOT:
        raise InputError(
            "gps_time",
            f"{grouped(int(counts[most]))} points have the time {times[most]:g}, and no shot has "
            f"so many; set it to NaN where it is not known, or {remedy}",
        )


def refuse_large(name: str, what: str, needed: int, remedy: str) -> None:
    """Refuse what needs more memory, beside the process itself [byte], than this machine has."""
    # To ask for the limit takes half a second.
    if needed < LOADED_BASE_BYTES or LOADED_BASE_BYTES + needed < usable_bytes(machine_memory()):
        return
    raise InputError(
        name,
        f"{what} need about {grouped(needed / 2**20)} MiB, more than {100 * USABLE_SHARE:.0f} % of "
        f"this machine's {grouped(machine_memory() / 2**20)} MiB; {remedy}, or leave out points "
        "that lie far from all others",
    )


def coarse(xyz: ArrayLike) -> tuple[str, ...]:
    """What a caller should know of coordinates whose type cannot hold centimetres."""
    place = np.asarray(xyz)
    if not len(place):
        return ()
    if place.dtype.kind in "iu":
        text = "xyz holds whole numbers, which are taken as metres"
        return (f"{text}; the X, Y, Z of a LAS file are counts: give its scaled coordinates",)
    farthest = np.abs(place).max()
    step_m = float(np.spacing(farthest))
    if step_m <= COARSE_M:
        return ()
    text = f"xyz is {place.dtype}, which holds {farthest:.0f} m to {step_m:.2g} m only"
    return (f"{text}; points are rounded to that; give float64",)
