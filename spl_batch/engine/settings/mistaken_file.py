"""Files and folders that a command was given and cannot take, and the command that takes each."""

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import yaml

from spl_batch.engine.settings.yaml_text import parse_yaml
from spl_batch.errors import WorkflowError
from spl_batch.formats.files.atomic import of_a_file

_HEAD_BYTES: Final = 4096
_MOST_YAML_BYTES: Final = 1 << 20

_AS_INPUT: Final = "name it in a workflow file, which `spl-batch run` takes"
_AS_CLOUD: Final = f"{_AS_INPUT}, or label it alone by `spl-batch denoise`"
_AS_RASTER: Final = "no command reads rasters; `spl-batch run` takes a workflow file"
_AS_ARCHIVE: Final = "unpack it; `spl-batch run` takes a workflow file"

_FORMATS: Final[Mapping[bytes, tuple[str, str]]] = {
    b"LASF": ("a point file (LAS or LAZ)", _AS_CLOUD),
    b"\x89HDF": ("an HDF5 file", _AS_INPUT),
    b"PAR1": ("a Parquet file", _AS_INPUT),
    b"II*\0": ("a TIFF raster", _AS_RASTER),
    b"II+\0": ("a TIFF raster", _AS_RASTER),
    b"MM\0*": ("a TIFF raster", _AS_RASTER),
    b"SQLite": ("a database or GeoPackage", _AS_INPUT),
    b"%PDF": ("a PDF", "`spl-batch run` takes a workflow file"),
    b"PK\x03\x04": ("a ZIP archive", _AS_ARCHIVE),
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

_REPORTS: Final = ("report.json", "compare.json")
_OUTPUT_MARKS: Final = ("log.jsonl", "delivered.json", *_REPORTS)


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
    """Kind of a file or folder, and the command that takes it; empty for a possible workflow."""
    if path.is_dir():
        return _folder(path)
    try:
        with open(path, "rb", opener=of_a_file) as stream:
            head = stream.read(_HEAD_BYTES)
    except OSError:  # else the caller says why it cannot be read
        return url_fault(path)
    for begin, (what, remedy) in _FORMATS.items():
        if head.startswith(begin):
            made = remedy == _AS_RASTER and _is_output(path.parent)
            return (
                f"this is {what} of a run's results; {_AS_OUTPUT}"
                if made
                else (f"this is {what}; {remedy}")
            )
    if b"\0" in head:
        return f"this is a binary file; {_AS_INPUT}"
    if path.name == "log.jsonl" or path.name in _REPORTS or path.suffix.lower() == ".html":
        return f"this is a file of a run's results; {_AS_OUTPUT}"
    return ""


_AS_OUTPUT: Final = (
    "`spl-batch status` and `spl-batch report` take the folder that it lies in, `spl-batch run` "
    "the workflow"
)


def _folder(path: Path) -> str:
    if _is_output(path):
        return (
            "this is the output folder of a run; `spl-batch status` and `spl-batch report` take "
            "it, `spl-batch run` the workflow"
        )
    files = {file.name: _mapping(file) for file in sorted(path.glob("*.y*ml"))}
    for is_one in (is_workflow, is_scene):
        if name := next((name for name, content in files.items() if is_one(content)), ""):
            return f"this is a folder; name the file in it, such as {name}"
    if any(found for end in ("laz", "las") for found in path.glob(f"*.{end}")):
        return (
            "this is a folder of point files; name it in a workflow file (survey.flightlines: "
            "FOLDER/*.laz), which `spl-batch run` takes"
        )
    return "this is a folder; `spl-batch run` takes a workflow file"


def _is_output(path: Path) -> bool:
    return any((path / name).exists() for name in _OUTPUT_MARKS)


def no_output(path: Path, verb: str) -> str:
    """Why a path is no output folder of a run; empty where it may be one."""
    takes = f"`spl-batch {verb}` takes the output folder of a run"
    if not path.exists():
        return url_fault(path) or f"there is no such folder; {takes}"
    if path.is_dir():
        return "" if _is_output(path) else f"{_no_run(path)}; {takes}"
    if path.name in _OUTPUT_MARKS or path.suffix.lower() == ".html":
        return f"this is a file of a run's results; {takes}, here {path.parent}"
    content = _mapping(path)
    if is_scene(content):
        return f"this is a scene, which `spl-batch simulate` takes; {takes}"
    if is_workflow(content):
        named = content.get("output")
        here = f", here {path.parent / str(named)}" if named else ""
        return f"this is a workflow; {takes}{here}"
    what = called(path).partition(";")[0] or "this is a file"
    return f"{what}; {takes}"


def _no_run(path: Path) -> str:
    """Say of a folder that no run has worked there, and where one may have."""
    near = next(_outputs_of(path), None)
    hint = f"; try {near}" if near else ""
    return f"no run has worked here (no log.jsonl){hint}"


def _outputs_of(path: Path) -> Iterator[Path]:
    """Output folders that the workflows of a folder name, where runs have worked."""
    for file in sorted(path.glob("*.y*ml")):
        named = _mapping(file).get("output")
        if isinstance(named, str) and _is_output(path / named):
            yield path / named


def _mapping(path: Path) -> dict[str, Any]:
    """Content of a YAML file that holds a mapping; nothing of any other."""
    try:
        if not path.is_file() or path.stat().st_size > _MOST_YAML_BYTES:
            return {}
        content = parse_yaml(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError):  # it is something else, then
        return {}
    return content if isinstance(content, dict) else {}
