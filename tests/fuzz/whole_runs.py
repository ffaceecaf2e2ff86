"""Whole runs on sound files beside mutants: what holds whatever has become of these.

The exit status is 0 or 1, or 2 where nothing could be started; nobody sees a traceback or a line
of more than 300 characters; every point of what was read is delivered; the sound files are
delivered, and open.
"""

import json
import shutil
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import laspy
import yaml

from spl_batch.geiger.coincidence.simulate import simulate as simulate_looks
from tests import surveys
from tests.altimetry.tracks import small_track, write_atl03
from tests.altimetry.tracks import write_workflow as write_track_workflow
from tests.fuzz.mutants import Seed
from tests.fuzz.readers import LIMIT_S, BrokenPromiseError, little_memory
from tests.fuzz.seeds import file_ends, las_parts, seed
from tests.geiger.coincidence.coincidence_scene import SMALL
from tests.geiger.water.water_scene import write_tank

SHOTS: Final = 25


@dataclass(frozen=True)
class Kind:
    """What is mutated, and beside what.

    Parameters
    ----------
    seed : Seed
        Sound file that mutants are made of.
    sound : dict of str to bytes
        Files of a survey that is sound, workflow included.
    place : str
        Name of the first mutant; of the others ``1`` is another number.
    delivered : tuple of str
        What a run must deliver of the sound files.
    lost : bool
        Whether a mutant may be what the whole run rests on.
    """

    seed: Seed
    sound: dict[str, bytes]
    place: str
    delivered: tuple[str, ...]
    lost: bool = False


def kept(folder: Path) -> dict[str, bytes]:
    """Content of all files below a folder."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def _survey(folder: Path) -> dict[str, bytes]:
    for k in (1, 2):
        line = surveys.flightline(shots=SHOTS, psid=k, start_s=surveys.START_S + k, seed=k)
        surveys.write_cloud(folder / "lines" / f"good_{k}.laz", line)
    (folder / "trajectory.csv").write_bytes(seed("trajectory csv").content)
    surveys.write_workflow(folder)
    return kept(folder)


def _with_setting(files: dict[str, bytes], section: str, key: str, value: str) -> dict[str, bytes]:
    """The files of a survey with one more setting in its workflow."""
    content = yaml.safe_load(files["workflow.yaml"])
    (content.setdefault(section, {}) if section else content)[key] = value
    return {**files, "workflow.yaml": yaml.safe_dump(content).encode()}


def _line(suffix: str, **options: object) -> Seed:
    with TemporaryDirectory() as folder:
        line = surveys.flightline(shots=SHOTS, psid=3, start_s=surveys.START_S + 3, seed=3)
        path = surveys.write_cloud(Path(folder) / f"a{suffix}", line, **options)  # type: ignore[arg-type]
        content = path.read_bytes()
    return Seed(content, suffix, tuple(las_parts(content)))


@cache
def kind(name: str) -> Kind:
    """A kind of whole run, by its name in :data:`KINDS`."""
    with TemporaryDirectory() as place:
        folder = Path(place)
        lines = ("laz/lines/good_1.laz", "laz/lines/good_2.laz")
        if name == "flightlines":
            return Kind(_line(".laz"), _survey(folder), "lines/mutant_1.laz", lines)
        if name == "old flightlines":
            made = _line(".las", version="1.2", point_format=1)
            return Kind(made, _survey(folder), "lines/mutant_1.las", lines)
        if name == "trajectory":
            # Beside a sound one, as a survey has one for each flight.
            sound = _with_setting(_survey(folder), "survey", "trajectory", "trajectory*.csv")
            return Kind(seed("trajectory csv"), sound, "trajectory_1.csv", lines)
        if name == "reference":
            sound = _survey(folder)
            sound["known.laz"] = sound["lines/good_1.laz"]
            sound = _with_setting(sound, "reference", "points", "known*.laz")
            return Kind(_line(".laz"), sound, "known_1.laz", lines)
        if name == "polygons":
            sound = _with_setting(_survey(folder), "", "aoi", "aoi.gpkg")
            return Kind(seed("gpkg"), sound, "aoi.gpkg", lines, lost=True)
        return _of_receiver(name, folder)


def _of_receiver(name: str, folder: Path) -> Kind:
    """The same of the other receivers."""
    if name == "granules":
        write_atl03(folder / "good.h5", {"gt1r": small_track(1, length_m=120.0)})
        write_track_workflow(folder, "*.h5")
        return Kind(seed("atl03"), kept(folder), "mutant_1.h5", ())
    if name in LOOKS:
        simulate_looks(SMALL, folder)
        files, first = kept(folder), f"l1/pass_1_{name.partition(' ')[0]}.parquet"
        made = Seed(files[first], ".parquet", tuple(file_ends(files[first])))
        return Kind(made, files, first, ())
    workflow = write_tank(folder)
    files = kept(workflow.parent)
    (first, *_) = sorted(n for n in files if n.startswith("frames/") and n.endswith(".h5"))
    return Kind(Seed(files[first], ".h5"), files, first, ())


LOOKS: Final = ("detections of looks", "frames of looks")
"""Both files of a pass of Geiger-mode looks."""

KINDS: Final = (
    "flightlines", "old flightlines", "trajectory", "reference", "polygons", "granules", "tank",
    *LOOKS,
)  # fmt: skip
"""Kinds of whole runs."""


def attempt(name: str, mutants: Sequence[bytes], folder: Path) -> int:
    """Run a survey with mutants in an empty folder; its exit status.

    Raises
    ------
    BrokenPromiseError
        If what must hold does not.
    """
    what = kind(name)
    for path, content in what.sound.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_bytes(content)
    for number, content in enumerate(mutants, start=1):
        (folder / what.place.replace("1", str(number))).write_bytes(content)
    begin_s = time.process_time()
    with little_memory():
        ended = surveys.command("run", folder / "workflow.yaml", "--workers", 0)
    try:
        _judge(what, ended, time.process_time() - begin_s, folder)
    except BrokenPromiseError as error:
        raise BrokenPromiseError(f"{error}\n{ended.text[-4000:]}") from error
    finally:
        shutil.rmtree(folder / "out", ignore_errors=True)
    return ended.status


def _judge(what: Kind, ended: surveys.Ended, took_s: float, folder: Path) -> None:
    if took_s > LIMIT_S:
        raise BrokenPromiseError(f"took {took_s:.0f} s")
    if ended.status not in ({0, 1, 2} if what.lost else {0, 1}):
        raise BrokenPromiseError(f"exit status {ended.status}")
    if not all(line.isprintable() or "\u202f" in line for line in ended.text.splitlines()):
        raise BrokenPromiseError("control characters on the screen")
    if ended.status != 2:
        _compare(what, ended, folder)


def _compare(what: Kind, ended: surveys.Ended, folder: Path) -> None:
    """Look whether points are lost, and the sound files delivered."""
    report = json.loads((folder / "out/report.json").read_text(encoding="utf-8"))
    counts = report.get("counts", {})
    if counts.get("points_in") != counts.get("points_out"):
        raise BrokenPromiseError(f"{counts['points_in']} points in, {counts['points_out']} out")
    if what.lost and ended.status == 1:
        return
    for name in what.delivered:
        given = laspy.read(folder / name.removeprefix("laz/"))
        if len(laspy.read(folder / "out" / name).points) != len(given.points):
            raise BrokenPromiseError(f"{name} has lost points")
    for path in (folder / "out").rglob("*.laz"):
        laspy.read(path)
