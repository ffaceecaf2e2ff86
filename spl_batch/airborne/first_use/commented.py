"""A workflow for the files of a folder: what was found is written, what was not is said."""

import glob
import json
import math
import re
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import yaml
from pyproj import CRS

from spl_batch.airborne.first_use.clouds import (
    SENSOR,
    STANDARDS,
    CloudLook,
    Guess,
    by_crs,
    channel_guess,
    crs_guess,
)
from spl_batch.airborne.first_use.folder import Folder
from spl_batch.airborne.sensors.sensor import load_preset
from spl_batch.errors import counted, grouped, named, plain
from spl_batch.formats.crs import crs_name, same_crs
from spl_batch.formats.files.atomic import real_path

SMALL_M2: Final = 10_000.0
"""Area below which it is told in square metres [m2]."""

SPARSE_M2: Final = 2.0
"""Density in its box below which a cloud without beamlet numbers is taken for linear-mode lidar:
single-photon surveys have ten times as many points and more, noise included [1/m2]."""

_PLAIN: Final = re.compile(r"[A-Za-z][\w./*:-]*")


@dataclass
class Proposal:
    """A workflow file in the making."""

    lines: list[str] = field(default_factory=list)
    #: Key and what was seen; key and what files do not tell.
    found: list[tuple[str, str]] = field(default_factory=list)
    unknown: list[tuple[str, str]] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)  #: Files that it does not name, and why.

    @property
    def text(self) -> str:
        """Content of the file."""
        return "\n".join(self.lines) + "\n"

    def section(self, name: str) -> None:
        """Begin a section."""
        self.lines += ["", f"{name}:"]

    def known(self, key: str, value: Any, reason: str, label: str = "") -> None:
        """Write a key of a section, and above it why it has this value."""
        self.found.append((label or key, plain(reason)))
        self.lines += [f"  # {plain(reason)}", *_key(key, value, "  ")]

    def supposed(self, key: str, value: str, reason: str) -> None:
        """Write a key that has to have a value, and above it that this one may be wrong."""
        self.unknown.append((key, reason))
        self.lines += [f"  # ? {reason}", *_key(key, value, "  ")]

    def note(self, key: str, reason: str) -> None:
        """Write what has to be settled elsewhere, as a comment."""
        self.unknown.append((key, reason))
        self.lines += _wrapped(f"? {key}: {reason}", "  ")

    def open(self, key: str, example: Any, reason: str, *, indent: str = "  ") -> None:
        """Write a key as a comment, and above it what is not known."""
        self.unknown.append((key, plain(reason)))
        shown = [f"{indent}# {line.strip()}" for line in _key(key, example, "")]
        self.lines += [f"{indent}# ? {plain(reason)}", *shown]


def _wrapped(text: str, indent: str = "") -> list[str]:
    """A comment, in more than one line where it is long."""
    begin = f"{indent}# "
    return textwrap.wrap(plain(text), 98, initial_indent=begin, subsequent_indent=begin)


def propose(folder: Folder) -> Proposal:
    """Write a workflow for what a folder holds."""
    sensor = load_preset(SENSOR)
    made = Proposal(
        [
            "# Written by `spl-batch init` from what the files tell. A `?` marks what they do not",
            "# tell: look at these lines first. docs/using.md explains the keys that are not here.",
            "#",
            "#   spl-batch plan workflow.yaml    what a run costs, what is wrong with the inputs",
            "#   spl-batch run workflow.yaml     everything; run again, it continues",
        ]
    )
    made.section("survey")
    made.lines += _key("name", real_path(folder.path).name or "survey", "  ")
    lines = [*_paths(folder.lines), *folder.damaged_lines]
    made.known("flightlines", _patterns(folder, lines), _clouds(folder.lines))
    _times(made, folder)
    _crs(made, folder)
    made.supposed("sensor", SENSOR, "no file tells the instrument: spl100, hrqls, or its facts")
    channel = channel_guess(folder.lines, sensor)
    if channel.value is not None:
        made.known("channel_dimension", channel.value, f"{channel.value} {channel.reason}")
    else:
        made.open("channel_dimension", "user_data", channel.reason)
    _reference(made, folder)
    _polygons(made, folder)
    made.lines += ["", "output: out"]
    _filter(made, folder, channel)
    made.left_out += _left_out(folder)
    return made


def _clouds(looks: Sequence[CloudLook]) -> str:
    """How much there is."""
    points = sum(look.facts.n_points for look in looks)
    said = f"{counted(len(looks), 'files')}, {counted(points, 'points')}"
    area_m2 = sum(look.area_m2 for look in looks)
    if area_m2 < 1.0:  # of degrees, or of next to nothing
        return said
    small = area_m2 < SMALL_M2
    area = f"{grouped(area_m2)} m2" if small else f"{grouped(area_m2 / 1e6, 3)} km2"
    return f"{said}, boxes of {area} in all, {_density(points / area_m2)} points per m2 of them"


def _density(per_m2: float) -> str:
    """A density in digits that show it, however small."""
    if per_m2 < 0.01:
        return "under 0.01"
    return grouped(per_m2, 1 if per_m2 >= 1.0 else 2)


def _times(made: Proposal, folder: Folder) -> None:
    spans = [look.span_s for look in folder.lines if look.span_s is not None]
    if not spans:
        has = all(look.facts.has_gps_time for look in folder.lines)
        seen = "one value for all points that were looked at" if has else "missing"
        made.unknown.append(("gps_time", f"{seen}, so there are no shots: noise is not told"))
        return
    standards = sorted({look.standard for look in folder.lines if look.span_s is not None})
    first, last = min(low for low, _ in spans), max(high for _, high in spans)
    kind = " and ".join(STANDARDS[one] for one in standards)
    seen = f"gps_time: {kind}, {grouped(first)} to {grouped(last)} s"
    made.found.append(("gps_time", seen.removeprefix("gps_time: ")))
    made.lines.append(f"  # {seen}")
    if folder.trajectories:
        paths = [*folder.trajectories]
        names = named([folder.named(path) for path in paths], 3)
        whose = "its times meet" if len(paths) == 1 else "their times meet"
        doubles = named([folder.named(path) for path in folder.doubles], 3)
        more = f"; {doubles} {'has' if len(folder.doubles) == 1 else 'have'} them too"
        made.known(
            "trajectory",
            _patterns(folder, paths),
            f"{names}: {whose} those of the flightlines{more if folder.doubles else ''}",
        )
    else:
        made.open(
            "trajectory",
            "trajectory/*.sbet",
            "no trajectory of these times is here: beams come from where lines of sight meet",
        )


def _crs(made: Proposal, folder: Folder) -> None:
    several = by_crs(folder.lines)
    crs = crs_guess(folder.lines)
    if len(several) > 1:
        made.note("CRS", _of_several(folder, several))
    elif crs.value is None:
        made.open("crs", "EPSG:32615", crs.reason)
    else:
        made.found.append(("CRS", crs.reason))
        made.lines.append(f"  # CRS: {plain(crs.reason)}")


def _of_several(folder: Folder, several: Sequence[tuple[CRS, Sequence[CloudLook]]]) -> str:
    """That flightlines are in more than one CRS, and what helps."""
    parts = []
    for crs, looks in several:
        names = named([folder.named(path) for path in _paths(looks)], 2)
        parts.append(f"{crs_name(crs)} in {names}")
    return (
        f"the flightlines are in {len(several)} CRS: {'; '.join(parts)}. A run takes the first, of "
        "most points, and leaves the other files out as failures: reproject them, or put the files "
        "of each CRS into a folder of its own and init each"
    )


def _foreign_references(folder: Folder) -> list[CloudLook]:
    """References that are not in the survey's CRS, which a run would refuse."""
    several = by_crs(folder.lines)
    return [
        look
        for look in folder.references
        if several and look.facts.crs is not None and not same_crs(look.facts.crs, several[0][0])
    ]


def _reference(made: Proposal, folder: Folder) -> None:
    foreign = _foreign_references(folder)
    references = [look for look in folder.references if look not in foreign]
    if not references and not folder.checkpoints:
        return
    made.section("reference")
    if references:
        paths = _paths(references)
        reason = f"class 2, ground, in other clouds: {_clouds(references)}"
        made.known("points", _patterns(folder, paths), reason, "reference")
    if folder.checkpoints:
        names = [folder.named(path) for path in folder.checkpoints]
        made.known("checkpoints", names[0], f"by its columns; of {named(names, 3)}")


def _polygons(made: Proposal, folder: Folder) -> None:
    if folder.polygons:
        names = [folder.named(path) for path in folder.polygons]
        made.lines.append("")
        reason = (
            f"polygons are here, {named(names, 3)}: of water, or of the area of interest (aoi)?"
        )
        made.open("water", names[0], reason, indent="")


_KEPT: Final = ("filter: {method: none}", "afterpulse: {enabled: false}")
"""Lines of a workflow by which every point stays."""


def _filter(made: Proposal, folder: Folder, channel: Guess) -> None:
    """Whether there is noise to be found, and what that needs."""
    if all(look.span_s is None for look in folder.lines):
        text = "# Without times no noise is told: every point stays; ground and surfaces are made."
        made.lines += ["", text, *_KEPT]
        return
    if channel.value is None and _points_per_m2(folder.lines) < SPARSE_M2:
        why = (
            "no beamlet numbers and few points per m2: taken for linear-mode lidar, of which every "
            "point stays; if single photons were counted, delete the last two lines of the workflow"
        )
        made.unknown.append(("filter", why))
        made.lines += ["", *_wrapped(f"? {why}"), *_KEPT]
        return
    made.lines += [
        "",
        "# Pulse rate [Hz] and slant length of the range gate [m] are estimated from the points.",
        "# acquisition: {prf_hz: 60000, gate_m: 300}",
    ]
    if channel.value is None:
        why = (
            "if this is linear-mode lidar, which has no such noise, remove the # before the last "
            "two lines of the workflow"
        )
        made.unknown.append(("filter", why))
        made.lines += ["", *_wrapped(f"? {why}"), *(f"# {line}" for line in _KEPT)]


def _points_per_m2(looks: Sequence[CloudLook]) -> float:
    """Points per area of the boxes; infinite where these have none."""
    area_m2 = sum(look.area_m2 for look in looks)
    points = sum(look.facts.n_points for look in looks)
    return points / area_m2 if area_m2 >= 1.0 else math.inf


def _left_out(folder: Folder) -> Iterator[str]:
    """Files that the workflow does not name, and why."""
    for error in folder.bad:
        if Path(error.path) not in folder.damaged_lines:
            yield str(error)
    for paths, why in (
        (_paths(folder.others), "no times or beamlet numbers like the others', no ground"),
        (
            _paths(_foreign_references(folder)),
            "ground in another CRS than the flightlines'; reproject it to make it the reference",
        ),
        (folder.results, "delivered by a run"),
        (folder.elsewhen, "times of another flight"),
        (folder.foreign, "files of another receiver"),
    ):
        if paths:
            yield f"{named([folder.named(path) for path in paths], 3)}: {why}"


def _paths(looks: Sequence[CloudLook]) -> list[Path]:
    return [look.facts.path for look in looks]


def _patterns(folder: Folder, paths: Sequence[Path]) -> str | list[str]:
    """Files as patterns where these match nothing else, else by name."""
    found: list[str] = []
    for place in sorted({path.parent for path in paths}):
        for suffix in sorted({path.suffix for path in paths if path.parent == place}):
            these = sorted(p for p in paths if p.parent == place and p.suffix == suffix)
            pattern = f"*{suffix}"
            if len(these) > 1 and these == sorted(place.glob(pattern)):
                found.append(f"{glob.escape(folder.named(place))}/{pattern}".removeprefix("./"))
            else:
                found += [glob.escape(folder.named(path)) for path in these]
    return found[0] if len(found) == 1 else found


def _key(key: str, value: Any, indent: str) -> list[str]:
    """A key and its value, a list one below the other."""
    if isinstance(value, list):
        return [f"{indent}{key}:", *(f"{indent}  - {_scalar(one)}" for one in value)]
    return [f"{indent}{key}: {_scalar(value)}"]


def _scalar(value: str) -> str:
    """Text as YAML reads it back."""
    if _PLAIN.fullmatch(value) and yaml.safe_load(value) == value:
        return value
    return json.dumps(value)
