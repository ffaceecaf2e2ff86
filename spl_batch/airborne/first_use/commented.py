"""A workflow for the files of a folder: what was found is written, what was not is said."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

from pyproj import CRS

from spl_batch.airborne.first_use.clouds import (
    SENSOR,
    STANDARDS,
    CloudLook,
    Guess,
    by_crs,
    channel_guess,
    crs_guess,
    linear_mode_signs,
)
from spl_batch.airborne.first_use.folder import Folder, look_through
from spl_batch.airborne.plan.inputs.survey_inputs import NO_POINTS
from spl_batch.airborne.sensors.sensor import load_preset
from spl_batch.engine.verbs.beginning import Beginning, headed, key_lines, patterns, wrapped
from spl_batch.errors import counted, grouped, named, plain
from spl_batch.formats.crs import crs_name, same_crs
from spl_batch.formats.files.atomic import real_path

SMALL_M2: Final = 10_000.0
"""Area below which it is told in square metres [m2]."""


ByCrs = tuple[CRS, Sequence[CloudLook]]


def begin(place: Path) -> Beginning | None:
    """A workflow for the clouds below a folder; None where there are none.

    Raises
    ------
    WorkflowError
        If it is no folder, or no cloud in it can be used.
    """
    folder = look_through(place, load_preset(SENSOR))
    return propose(folder) if folder.lines else None


def propose(folder: Folder) -> Beginning:
    """Write a workflow for what a folder holds."""
    sensor = load_preset(SENSOR)
    several = by_crs(folder.lines)
    apart = [path for _, looks in several[1:] for path in _paths(looks)]
    folder = replace(folder, lines=[look for look in folder.lines if look.facts.path not in apart])
    made = headed("using")
    made.section("survey")
    made.lines += key_lines("name", real_path(folder.path).name or "survey", "  ")
    lines = [*_paths(folder.lines), *folder.damaged_lines]
    made.known("flightlines", patterns(folder.path, lines), _clouds(folder.lines))
    channel = channel_guess(folder.lines, sensor)
    linear = "" if channel.value is not None else linear_mode_signs(folder.lines)
    _times(made, folder, linear)
    _crs(made, folder, several)
    if not linear:
        made.supposed("sensor", SENSOR, "no file names the instrument: spl100, hrqls, or its facts")
    if channel.value is not None:
        made.known("channel_dimension", channel.value, f"{channel.value} {channel.reason}")
    elif not linear:
        made.open("channel_dimension", "user_data", channel.reason)
    _reference(made, folder)
    _polygons(made, folder)
    made.lines += ["", "output: out"]
    _filter(made, folder, channel, linear)
    made.left_out += _of_other_crs(folder, several)
    made.left_out += _left_out(folder)
    return made


def _clouds(looks: Sequence[CloudLook]) -> str:
    """How much there is."""
    points = sum(look.facts.n_points for look in looks)
    said = f"{counted(len(looks), 'files')}, {counted(points, 'points')}"
    area_m2 = sum(look.facts.area_m2 for look in looks)
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


def _times(made: Beginning, folder: Folder, linear: str) -> None:
    spans = [look.span_s for look in folder.lines if look.span_s is not None]
    if not spans:
        has = all(look.facts.has_gps_time for look in folder.lines)
        seen = "one value for all points that were looked at" if has else "missing"
        made.unknown.append(("gps_time", f"{seen}, so there are no shots: noise is not estimated"))
        return
    standards = sorted({look.standard for look in folder.lines if look.span_s is not None})
    first, last = min(low for low, _ in spans), max(high for _, high in spans)
    kind = " and ".join(STANDARDS[one] for one in standards)
    seen = f"gps_time: {kind}, {grouped(first)} to at least {grouped(last)} s"
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
            patterns(folder.path, paths),
            f"{names}: {whose} those of the flightlines{more if folder.doubles else ''}",
        )
    elif not linear:
        made.open(
            "trajectory",
            "trajectory/*.sbet",
            "no trajectory of these times is here: beams come from where lines of sight meet",
        )


def _crs(made: Beginning, folder: Folder, several: Sequence[ByCrs]) -> None:
    crs = crs_guess(folder.lines)
    if len(several) > 1:
        made.note("CRS", _of_several(folder, several))
    elif crs.value is None:
        made.open("crs", "EPSG:32615", crs.reason)
    else:
        made.found.append(("CRS", crs.reason))
        made.lines.append(f"  # CRS: {plain(crs.reason)}")


def _of_other_crs(folder: Folder, several: Sequence[ByCrs]) -> Iterator[str]:
    """Flightlines that are not in the survey's CRS, which a run would refuse."""
    for crs, looks in several[1:]:
        names = named([folder.named(path) for path in _paths(looks)], 3)
        yield (
            f"{names}: in {crs_name(crs)}, the survey in {crs_name(several[0][0])}; reproject it, "
            "or init it in a folder of its own"
        )


def _of_several(folder: Folder, several: Sequence[ByCrs]) -> str:
    """That flightlines are in more than one CRS, and what helps."""
    parts = []
    for crs, looks in several:
        names = named([folder.named(path) for path in _paths(looks)], 2)
        parts.append(f"{crs_name(crs)} in {names}")
    return (
        f"the flightlines are in {len(several)} CRS: {'; '.join(parts)}. The workflow has the "
        "first, and leaves the other files out: reproject them, or put the files of each CRS into "
        "a folder of its own and init each"
    )


def _foreign_references(folder: Folder) -> list[CloudLook]:
    """References that are not in the survey's CRS, which a run would refuse."""
    several = by_crs(folder.lines)
    return [
        look
        for look in folder.references
        if several and look.facts.crs is not None and not same_crs(look.facts.crs, several[0][0])
    ]


def _reference(made: Beginning, folder: Folder) -> None:
    foreign = _foreign_references(folder)
    references = [look for look in folder.references if look not in foreign]
    if not references and not folder.checkpoints:
        return
    made.section("reference")
    if references:
        paths = _paths(references)
        reason = f"class 2, ground, in other clouds: {_clouds(references)}"
        made.known("points", patterns(folder.path, paths), reason, "reference")
    if folder.checkpoints:
        names = [folder.named(path) for path in folder.checkpoints]
        made.known("checkpoints", names[0], f"by its columns; of {named(names, 3)}")


def _polygons(made: Beginning, folder: Folder) -> None:
    if folder.polygons:
        names = [folder.named(path) for path in folder.polygons]
        made.lines.append("")
        reason = (
            f"polygons are here, {named(names, 3)}: of water, or of the area of interest (aoi)?"
        )
        made.open("water", names[0], reason, indent="")


_KEPT: Final = ("filter: {method: none}", "afterpulse: {enabled: false}")
"""Lines of a workflow by which every point stays."""


def _filter(made: Beginning, folder: Folder, channel: Guess, linear: str) -> None:
    """Whether there is noise to be found, and what that needs."""
    if all(look.span_s is None for look in folder.lines):
        text = (
            "# Without times noise is not known: every point stays; ground and surfaces are made."
        )
        made.lines += ["", text, *_KEPT]
        return
    if linear:
        why = (
            f"{linear}: taken for linear-mode lidar, of which every point stays; "
            "if single photons were counted, delete the last two lines of the workflow, and "
            "name the instrument, survey.sensor"
        )
        made.unknown.append(("filter", why))
        made.lines += ["", *wrapped(f"? {why}"), *_KEPT]
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
        made.lines += ["", *wrapped(f"? {why}"), *(f"# {line}" for line in _KEPT)]


def _left_out(folder: Folder) -> Iterator[str]:
    """Files that the workflow does not name, and why."""
    for error in folder.bad:
        if Path(error.path) not in folder.damaged_lines:
            yield str(error)
    for paths, why in (
        ([look.facts.path for look in folder.others if not look.facts.n_points], NO_POINTS),
        (
            [look.facts.path for look in folder.others if look.facts.n_points],
            "no times or beamlet numbers like the others', no ground",
        ),
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
