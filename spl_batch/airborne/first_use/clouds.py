"""What a cloud tells of the survey that it is from, by its header and both of its ends.

Each value that nobody has said comes with its reason, so that a user can judge the guess.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from pyproj import CRS

from spl_batch.airborne.plan.inputs.channel_dimension import numbered_dimension
from spl_batch.airborne.plan.inputs.first_look import holds_few
from spl_batch.airborne.plan.inputs.linear_mode import Density
from spl_batch.airborne.sensors.sensor import Sensor
from spl_batch.formats.crs import crs_name, crs_problems, look_like_degrees, same_crs
from spl_batch.formats.gps_clock import TimeStandard, time_standard, usable_times
from spl_batch.formats.las.reader import SAMPLE_POINTS, Ends, LasFacts, inspect, read_ends

SENSOR: Final = "spl100"
"""What is supposed: no file tells the instrument."""

CHANNEL_NAMES: Final = ("channel", "beamlet", "channel_number", "beamlet_number", "detector")
"""Names of dimensions of its own that a file holds beamlet numbers in, as they are written."""

STANDARDS: Final[dict[TimeStandard, str]] = {
    "week": "seconds of the GPS week",
    "adjusted": "adjusted standard GPS time",
    "unix_or_gps": "seconds since 1970 or 1980",
    "other": "of no known standard",
    "none": "missing",
}
"""What the values of ``gps_time`` look like, in words."""


_UNSEEN: Final = Ends(np.empty(0), np.empty(0, np.uint8), {}, (), (), used=True)


class Guess(NamedTuple):
    """A value that nobody has given, and what it is guessed from."""

    value: str | None  #: The value; None where there is nothing to guess it from.
    reason: str  #: What was seen, in words.


@dataclass(frozen=True, slots=True)
class CloudLook:
    """Header of a file, and some points of both of its ends."""

    facts: LasFacts
    ends: Ends  #: Times, and dimensions that hold small whole numbers.

    @property
    def span_s(self) -> tuple[float, float] | None:
        """First and last time that was seen; None where times do not tell shots apart [s]."""
        time = self.ends.gps_time[usable_times(self.ends.gps_time)]
        if not len(time) or np.all(time == time[0]):
            return None
        return float(time.min()), float(time.max())

    @property
    def standard(self) -> TimeStandard:
        """Standard that the times seem to be in."""
        return "none" if self.span_s is None else time_standard(np.array(self.span_s))


def look_at(path: Path, *, points: bool = True) -> CloudLook:
    """Look at a file, which takes a tenth of a second whatever its size.

    Parameters
    ----------
    path : Path
        LAS, LAZ or COPC.
    points : bool
        Whether to look at points as well as at the header.

    Raises
    ------
    InputError
        If it cannot be read.
    """
    facts = inspect(path)
    return CloudLook(facts, read_ends(path, None, SAMPLE_POINTS) if points else _UNSEEN)


def channel_guess(looks: Sequence[CloudLook], sensor: Sensor) -> Guess:
    """Which dimension holds the beamlet numbers: by what it holds, else by its name."""
    held = {look.facts.path.name: look.ends.numbers for look in looks}
    found = numbered_dimension(held, sensor)
    if found is not None:
        name, ranges = found
        spans = " and ".join(ranges)
        reason = f"holds {spans}, as the {sensor.beamlets} beamlets of {sensor.name} are numbered"
        return Guess(name, reason)
    for name in CHANNEL_NAMES:
        numbers = [one[name] for one in held.values() if name in one]
        if len(numbers) == len(looks) and not any(
            holds_few(one.different, one.points, sensor) for one in numbers
        ):
            low, high = min(one.low for one in numbers), max(one.high for one in numbers)
            return Guess(name, f"is called so, and holds {low} to {high}")
    return Guess(None, "no dimension holds beamlet numbers, so each shot counts as one beamlet")


def linear_mode_signs(looks: Sequence[CloudLook]) -> str:
    """What speaks for linear-mode lidar where no beamlets are numbered; empty if nothing does."""
    density = Density()
    for look in looks:
        density.add(look.facts, look.ends.gps_time)
    return density.signs


def by_crs(looks: Sequence[CloudLook]) -> list[tuple[CRS, list[CloudLook]]]:
    """Clouds by the CRS that their headers name: those that can be used first, of most points."""
    found: list[tuple[CRS, list[CloudLook]]] = []
    for look in looks:
        crs = look.facts.crs
        if crs is None or not look.facts.n_points:
            continue
        alike = next((those for one, those in found if same_crs(one, crs)), None)
        if alike is None:
            found.append((crs, [look]))
        else:
            alike.append(look)
    return sorted(found, key=lambda one: (bool(crs_problems(one[0])), -sum(map(_points, one[1]))))


def _points(look: CloudLook) -> int:
    return look.facts.n_points


def crs_guess(looks: Sequence[CloudLook]) -> Guess:
    """CRS of the files, by their headers."""
    told = [look.facts.crs for look in looks if look.facts.crs is not None]
    wrong = sorted({crs_name(crs) for crs in told if crs.is_geocentric})
    if wrong:
        reason = f"the files name {wrong[0]}, which is geocentric: name the CRS of the coordinates"
        return Guess(None, reason)
    names = sorted({crs.name for crs in told})
    if not names and any(look_like_degrees(look.facts.mins_m, look.facts.maxs_m) for look in looks):
        return Guess(None, "no file names one, and the coordinates look like degrees")
    if not names:
        return Guess(None, "no file names one: coordinates are taken as metres, rasters have none")
    return Guess(names[0], "the files name " + " and ".join(names))
