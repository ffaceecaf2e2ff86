"""A first workflow for photons along a track: by the headers of the files."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from spl_batch.altimetry.formats.atl08 import no_atl08
from spl_batch.altimetry.formats.photons import HDF5, TrackFile, inspect
from spl_batch.altimetry.formats.track_csv import is_track
from spl_batch.engine.verbs.beginning import Beginning, files_below, headed, key_lines, patterns
from spl_batch.errors import InputError, WorkflowError, counted, named
from spl_batch.formats.files.atomic import real_path


@dataclass
class _Folder:
    """What was found in a folder."""

    tracks: list[TrackFile] = field(default_factory=list)
    tables: list[TrackFile] = field(default_factory=list)  #: CSV with the columns of a track.
    labels: list[Path] = field(default_factory=list)  #: ATL08.
    bad: list[InputError] = field(default_factory=list)


def begin(folder: Path) -> Beginning | None:
    """A workflow for the tracks below a folder; None where it holds none.

    Raises
    ------
    WorkflowError
        If it holds HDF5 files, and none has photons that can be read.
    """
    found = _Folder()
    for path in files_below(folder):
        try:
            _sort_in(path, found)
        except InputError as error:
            found.bad.append(error)
    if found.tracks or found.tables:
        return _draft(folder, found)
    if found.bad:
        raise WorkflowError(f"{folder}: no photon file can be used: {found.bad[0]}")
    if found.labels:
        name = found.labels[0].relative_to(folder)
        raise WorkflowError(
            f"{folder}: {name} is an ATL08 file, which has labels and no photons; put the ATL03 "
            "file of the same granule beside it"
        )
    return None


def _sort_in(path: Path, found: _Folder) -> None:
    suffix = path.suffix.lower()
    if suffix in HDF5 and not no_atl08(path):
        found.labels.append(path)
    elif suffix in HDF5:
        found.tracks.append(inspect(path))
    elif suffix == ".csv" and is_track(path):
        found.tables.append(inspect(path))


def _draft(folder: Path, found: _Folder) -> Beginning:
    tracks = found.tracks or found.tables
    made = headed("altimetry")
    made.lines += ["", "kind: altimetry"]
    made.section("track")
    made.lines += key_lines("name", real_path(folder).name or "track", "  ")
    made.known("photons", patterns(folder, [track.path for track in tracks]), _photons(tracks))
    tables = [table.path for table in found.tables] if found.tracks else []
    if found.labels or tables:
        made.lines += ["", "reference:" if found.labels else "# reference:"]
    if found.labels:
        pattern = patterns(folder, found.labels)
        reason = "ATL08: its labels of photons are compared with ours"
        if isinstance(pattern, str):
            made.known("labels", pattern, reason)
        else:
            apart = "put these files into one folder of their own"
            made.open("labels", pattern[0], f"{reason}; {apart}")
    if tables:
        names = [path.relative_to(folder).as_posix() for path in tables]
        made.open(
            "points",
            names[0],
            f"{named(names, 3)}: heights along a track; is it the true ground, to compare with?",
        )
    made.lines += [
        "",
        "# Heights below water corrected for refraction, as a column of their own:",
        "# outputs: {refraction: true}",
        "",
        "output: out",
    ]
    made.left_out += map(str, found.bad)
    return made


def _photons(tracks: Sequence[TrackFile]) -> str:
    """How much there is."""
    beams = sorted({beam.name for track in tracks for beam in track.beams})
    photons = sum(beam.photons for track in tracks for beam in track.beams)
    about = "about " * any(track.layout == "csv" for track in tracks)
    layouts = " and ".join(sorted({track.layout.upper() for track in tracks}))
    return (
        f"{layouts}: {counted(len(tracks), 'files')}, {about}{counted(photons, 'photons')}, "
        f"beams {named(beams, 6)}"
    )
