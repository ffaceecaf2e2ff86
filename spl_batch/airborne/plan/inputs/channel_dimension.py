"""Which dimension seems to hold the beamlet numbers where the workflow names none."""

from collections import Counter
from collections.abc import Mapping
from typing import Final

from spl_batch.airborne.sensors.sensor import Sensor
from spl_batch.engine.findings import Finding
from spl_batch.errors import named
from spl_batch.formats.las.reader import Numbers

POINTS_A_BEAMLET: Final = 20
"""Points of a beamlet, on average, from which on all that work have some [count]."""

BEAMLETS_MIN: Final = 10
"""With fewer beamlets many a dimension holds as many different numbers by accident [count], and one
that holds less than this part of more holds something else."""

LIVE_SHARE: Final = 0.95
"""Share of the beamlets that must be seen; a few channels may be dead."""

UNEVEN: Final = 5.0
"""A beamlet has at most so many times the mean number of returns; intensities are less even."""


def holds_few(channels: int, points: int, sensor: Sensor) -> bool:
    """Whether a dimension has too few different values to be that of the beamlets."""
    enough = points >= POINTS_A_BEAMLET * sensor.beamlets and sensor.beamlets > BEAMLETS_MIN
    return enough and BEAMLETS_MIN * channels <= sensor.beamlets


def are_beamlets(numbers: Numbers, sensor: Sensor) -> bool:
    """Whether a dimension holds the numbers of all beamlets, counted from 0 or from 1."""
    beamlets = sensor.beamlets
    enough = beamlets >= BEAMLETS_MIN and numbers.points >= POINTS_A_BEAMLET * beamlets
    within = numbers.high < beamlets or (numbers.low >= 1 and numbers.high == beamlets)
    all_of_them = numbers.different >= LIVE_SHARE * beamlets
    even = numbers.most * numbers.different <= UNEVEN * numbers.points
    return enough and within and all_of_them and even


def numbered_dimension(
    files: Mapping[str, Mapping[str, Numbers]], sensor: Sensor
) -> tuple[str, dict[str, list[str]]] | None:
    """The dimension that holds the beamlet numbers of most files; None where none is like that.

    With the files by the range of their numbers, such as ``1 to 100``. ``files``: what each
    dimension of each file holds, by their names.
    """
    like = {
        name: {key: one for key, one in held.items() if are_beamlets(one, sensor)}
        for name, held in sorted(files.items())
    }
    votes = Counter(key for held in like.values() for key in held)
    if not votes:
        return None
    chosen = max(votes, key=lambda key: (votes[key], key == "user_data", key))
    ranges: dict[str, list[str]] = {}
    for name, held in like.items():
        if chosen in held:
            ranges.setdefault(f"{held[chosen].low} to {held[chosen].high}", []).append(name)
    return chosen, ranges


def unnamed_channels(
    files: Mapping[str, Mapping[str, Numbers]], sensor: Sensor
) -> tuple[Finding, ...]:
    """Propose the dimension that holds the beamlet numbers of most files.

    The arguments are those of :func:`numbered_dimension`.
    """
    found = numbered_dimension(files, sensor)
    if found is None:
        return ()
    chosen, ranges = found
    listed = " and ".join(f"{span} in {named(names, 3)}" for span, names in ranges.items())
    values = {
        "kind": "unnamed", "dimension": chosen, "ranges": listed, "beamlets": sensor.beamlets,
        "sensor": sensor.name,
    }  # fmt: skip
    return (Finding("I04", values),)
