"""Files and folders that a command was given and cannot take, and the command that takes each."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from spl_batch.errors import WorkflowError

_FORMATS: Final[Mapping[bytes, str]] = {
    b"LASF": "a point file (LAS or LAZ): name it in a workflow, or label it by `spl-batch denoise`",
    b"\x89HDF": "an HDF5 file: name it in a workflow file",
    b"PAR1": "a Parquet file: name it in a workflow file",
    b"II*\0": "a TIFF raster, which no command reads",
    b"PK\x03\x04": "a ZIP archive: unpack it",
}
"""Kinds of files by their first bytes, and what helps who gives one to a command."""

_URL: Final = re.compile(r"[A-Za-z][\w+.-]+:/")
"""How a URL begins, also where two slashes have become one as those of a path do."""

_SCENE_KEYS: Final = frozenset(
    {
        *("extent_m", "flights", "terrain", "buildings", "trees", "sky"),
        *("targets", "flight", "channels"),
        *("mount", "target", "instrument", "acquisitions", "frames_per_acquisition"),
    }
)
"""Keys of scenes, for any receiver; of them a workflow has ``mount`` alone."""

_OUTPUT_MARKS: Final = ("log.jsonl", "delivered.json", "report.json")


def is_workflow(content: Mapping[str, Any]) -> bool:
    """Whether a YAML file's content is a workflow's, right or wrong."""
    survey = content.get("survey")
    return "output" in content or (isinstance(survey, dict) and "flightlines" in survey)


def is_scene(content: Mapping[str, Any]) -> bool:
    """Whether a YAML file's content is a scene's, right or wrong."""
    if is_workflow(content):
        return False
    track = content.get("track")
    simulated = isinstance(track, dict) and "photons" not in track
    return simulated or bool(_SCENE_KEYS & content.keys())


def url_fault(name: Path | str) -> str:
    """Why a place cannot be used that is a URL; empty where it is none."""
    if not _URL.match(str(name)) or Path(name).exists():
        return ""
    return "this is a URL: copy or mount it, and name a file or folder of this machine"


def refuse_urls(*names: Path | str | None) -> None:
    """Refuse places that are not of this machine; a path made of one would be a folder `s3:`.

    Raises
    ------
    WorkflowError
        One line that names the first.
    """
    for name in names:
        if name is not None and (fault := url_fault(name)):
            raise WorkflowError(f"{name}: {fault}")


def called(path: Path) -> str:
    """What a file or folder is that is no workflow; empty for a possible one."""
    if path.is_dir():
        if no_output(path, "status"):
            return "this is a folder: name the workflow file in it"
        return "this is the output folder of a run, which `spl-batch status` and `report` take"
    try:
        with path.open("rb") as stream:
            head = stream.read(64)
    except OSError:  # else the caller reports why it cannot be read
        return url_fault(path)
    what = next((what for begin, what in _FORMATS.items() if head.startswith(begin)), "")
    return f"this is {what or 'a binary file'}" if what or b"\0" in head else ""


def no_output(path: Path, verb: str) -> str:
    """Why a path is no output folder of a run; empty where it may be one."""
    takes = f"`spl-batch {verb}` takes the output folder of a run"
    if not path.is_dir():
        return url_fault(path) or f"there is no such folder; {takes}"
    if any((path / name).exists() for name in _OUTPUT_MARKS):
        return ""
    return f"no run has worked here (no log.jsonl); {takes}"
