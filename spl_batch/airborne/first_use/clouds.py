"""What a cloud shows of the survey that it is from, by its header and both of its ends.

Each value that nobody has given comes with its reason, so that a user can judge the guess.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from spl_batch.airborne.plan.inputs.channel_dimension import holds_few, numbered_dimension
from spl_batch.airborne.sensors.sensor import Sensor, load_preset
from spl_batch.errors import grouped
from spl_batch.formats.crs import look_like_degrees
from spl_batch.formats.gps_clock import usable_times
from spl_batch.formats.las.reader import SAMPLE_POINTS, Ends, LasFacts, inspect, read_ends
from spl_batch.formats.units import Units

SENSOR: Final = "spl100"
"""What is supposed: no file names the instrument."""

CHANNEL_NAMES: Final = ("channel", "beamlet", "channel_number", "beamlet_number", "detector")
"""Names of dimensions of its own that a file holds beamlet numbers in, as they are written."""


SPARSE_M2: Final = 2.0
"""Points over the area of a cloud's box below which it is linear-mode lidar: single-photon surveys
have ten times as many and more, noise included [1/m2]."""

RETURNS_A_SHOT: Final = 5.0
"""Points that share a time, on average, from which on they are of many beamlets [count]."""

IN_ORDER: Final = 0.9
"""Share of points no earlier than the point before, from which on those of a shot lie together."""


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
    def timed(self) -> bool:
        """Whether its times separate shots."""
        time = self.ends.gps_time[usable_times(self.ends.gps_time)]
        return bool(len(time)) and bool(np.any(time != time[0]))


class Guesses(NamedTuple):
    """What clouds show together."""

    timed: bool  #: Whether times separate shots, in any of them.
    channel: Guess  #: Which dimension holds the beamlet numbers.
    crs: Guess
    linear: str  #: What speaks for linear-mode lidar; empty if nothing does.


def look_at(path: Path) -> CloudLook:
    """Look at a file, which takes a tenth of a second whatever its size."""
    facts = inspect(path)
    return CloudLook(facts.in_metres(Units.of(facts.crs)), read_ends(path, None, SAMPLE_POINTS))


def guesses(looks: Sequence[CloudLook], sensor: str | None = None) -> Guesses:
    """All that is guessed of clouds; ``sensor``: preset of the instrument, if somebody knows it."""
    instrument = load_preset(sensor or SENSOR)
    timed, channel = any(look.timed for look in looks), channel_guess(looks, instrument)
    unknown = sensor is None and timed and channel.value is None
    linear = linear_mode_signs(looks) if unknown else ""
    return Guesses(
        timed, channel, crs_guess(looks), linear if instrument.photons else instrument.name
    )


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
    area_m2 = sum(look.facts.area_m2 for look in looks)
    sparse = sum(look.facts.n_points for look in looks) < SPARSE_M2 * area_m2
    times = [look.ends.gps_time[usable_times(look.ends.gps_time)] for look in looks]
    times = [one for one in times if len(one) > 1 and np.mean(np.diff(one) >= 0) >= IN_ORDER]
    shots = sum(len(np.unique(one)) for one in times)
    together = sum(map(len, times)) / max(shots, 1)
    found = ["few points per m2"] if sparse and area_m2 >= 1.0 else []
    if shots and together < RETURNS_A_SHOT:
        found.append(f"only {grouped(together, 1)} points at the same gps_time")
    return ", ".join(["no beamlet numbers", *found]) if found else ""


def crs_guess(looks: Sequence[CloudLook]) -> Guess:
    """CRS of the files, by their headers."""
    found = [look.facts.crs for look in looks if look.facts.crs is not None]
    names = sorted({crs.name for crs in found})
    if any(crs.is_geocentric for crs in found):
        reason = f"the files name {' and '.join(names)}, which is geocentric: name that of x and y"
        return Guess(None, reason)
    if names:
        return Guess(names[0], "the files name " + " and ".join(names))
    if any(look_like_degrees(look.facts.mins_m, look.facts.maxs_m) for look in looks):
        return Guess(None, "no file names one, and the coordinates look like degrees")
    return Guess(None, "no file names one: coordinates are taken as metres, rasters have none")
