"""One file, without a workflow: what nobody states is guessed, and printed.

The chain is that of a run, in a folder beside the result that is deleted in the end. It stays where
something failed or stopped the run, and the same command continues there.
"""

import shlex
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import yaml

from spl_batch.airborne.first_use.clouds import (
    SENSOR,
    CloudLook,
    Guesses,
    guesses,
    look_at,
)
from spl_batch.airborne.plan.inputs.survey_inputs import NO_POINTS
from spl_batch.airborne.plan.task_memory import STRETCH_POINTS
from spl_batch.airborne.precompile import compiling
from spl_batch.airborne.report.verdicts import count_rows
from spl_batch.airborne.settings.workflow import Workflow, load_workflow
from spl_batch.engine.plan.input_files import matching
from spl_batch.engine.report.number_format import as_ascii
from spl_batch.engine.settings.mistaken_file import refuse_urls
from spl_batch.engine.store.working_store import Store, read_json, read_receipts, write_json
from spl_batch.engine.tasks.input_changes import stamp
from spl_batch.engine.tasks.task import Receipt
from spl_batch.engine.verbs.running import RunResult, run
from spl_batch.engine.watch.events import Listener, Note, ignore
from spl_batch.errors import DamagedError, InputError, WorkflowError
from spl_batch.formats.files.atomic import real_path, remove, replacing, write_bytes

WORK: Final = ".work"
"""How the name of the folder ends that a result is made in, beside it."""

KEEP_ALL: Final = "filter.method=none"
"""Override by which every point stays, as in linear-mode lidar."""

_IN_OTHER_FILES: Final = (
    *("crs", "units", "cell", "copc", "tiles", "client_tiles", "contour_interval", "geoid"),
    "catalogue",
)
"""Settings of ``outputs`` whose results are files that only a run leaves."""

_WORKFLOW: Final = "workflow.yaml"
_LAST: Final = "deliver"
"""Stage after which all is there that is kept."""

_MOVED: Final = "moved.json"
"""Record of the results that were moved out of the folder: size and time of writing."""


def denoise(
    source: Path | str,
    target: Path | str,
    *,
    trajectory: Path | str | None = None,
    sensor: str | None = None,
    ground: bool = False,
    dtm: Path | str | None = None,
    force: bool = False,
    workers: int = 2,
    memory: str | int | None = None,
    overrides: Sequence[str] = (),
    listener: Listener = ignore,
) -> RunResult:
    """Label the noise of one file, and on request its ground.

    Parameters
    ----------
    source : Path or str
        LAS, LAZ or COPC with ``gps_time``.
    target : Path or str
        LAZ to write: every point, in order. Noise has class 7 or 18; ``noise_class`` has the kind.
    trajectory : Path or str, optional
        CSV, Parquet or SBET, or a pattern of several.
    sensor : str, optional
        Preset of the instrument; ``spl100`` by default.
    ground : bool
        Whether points of the ground get class 2, and the others the class that a run gives them;
        otherwise signal keeps the class that it has.
    workers : int
        Worker processes, at most: a small file has one; 0 works in this process.
    memory : str or int, optional
        Memory limit of a worker [byte]; a share of the machine's by default.
    overrides : sequence of str
        ``key.path=value`` of a workflow, such as ``filter.alpha=0.01``.
    listener : callable
        Gets what is guessed, and what happens.

    Returns
    -------
    RunResult
        ``screen`` counts the points; there is no report.

    Raises
    ------
    InputError
        If the file cannot be read, or holds no shots.
    WorkflowError, PlanError
        If nothing can be started; a result that is there is not replaced unless ``force`` is given.
    StoppedError
        If the run had to stop as a whole; the same call continues.
    """
    cloud, raster = Path(target), None if dtm is None else Path(dtm)
    folder = cloud.with_name(cloud.name + WORK)
    results = [(cloud, ".laz"), *([] if raster is None else [(raster, ".tif")])]
    refuse_urls(source, target, trajectory, dtm)
    _refuse(Path(source), results, _moved(folder), force=force)
    look = look_at(Path(source))
    kept = KEEP_ALL in {override.replace(" ", "") for override in overrides}
    seen = guesses([look], sensor)
    if seen.linear and not kept:
        raise WorkflowError(_as_linear_mode(Path(source), cloud, seen.linear))
    reasons, content = _proposal(look, seen, trajectory, sensor, ground=ground, kept=kept)
    if kept and (seen.linear or not look.timed):
        content["afterpulse"] = {"enabled": False}
        reasons["afterpulse"] = "every point stays: no afterpulses are looked for either"
    stated = {override.partition("=")[0].strip() for override in overrides}
    guessed = [f"guessed: {text}" for key, text in reasons.items() if key not in stated]
    new = [place for place in {path.parent for path, _ in results} if not place.exists()]
    for place in new:
        if not place.parent.exists():
            raise WorkflowError(f"{place}: there is no folder {place.parent}; check the path")
    with _leaving_nothing(folder):
        write_bytes(folder / _WORKFLOW, yaml.safe_dump(content, sort_keys=False).encode())
        workflow = load_workflow(folder / _WORKFLOW, overrides)
        _refuse_other_files(workflow)
        for text in (*(f"creates folder {place}" for place in new), *guessed):
            listener(Note("info", text))
        with compiling(workers, workflow, _LAST).beside():  # a first call waits for nothing as long
            found = run(
                folder / _WORKFLOW,
                workers=min(workers, -(-look.facts.n_points // STRETCH_POINTS)),
                memory=memory,
                until=_LAST,
                overrides=overrides,
                listener=listener,
            )
    store = Store(found.output)
    delivered = [r for r in read_receipts(store, "deliver_file") if not r.failed]
    if not delivered:
        note = ("attention", f"nothing was delivered, as reported above; {folder} has the log")
        return RunResult(found.exit_status, folder, None, (note,))
    moves = dict(_moves(found.output, delivered[0], cloud, raster))
    write_json(folder / _MOVED, {str(real_path(to)): stamp(path) for path, to in moves.items()})
    rows = (*_counts(delivered[0], ground=ground),)
    if found.exit_status:
        rows += (("attention", f"a part failed; the same command tries it again in {folder}"),)
    for path, to in moves.items():
        with replacing(to) as temporary:
            shutil.move(path, temporary)
    if found.exit_status == 0:
        remove(folder)
    *rasters, _ = moves.values()
    shown = ("cloud", [cloud]), ("terrain", rasters)
    return RunResult(found.exit_status, cloud.parent, None, rows, shown)


@contextmanager
def _leaving_nothing(folder: Path) -> Iterator[None]:
    """Remove a folder that was not there if nothing could be started."""
    new = not folder.exists()
    try:
        yield
    except (InputError, WorkflowError):
        if new:
            remove(folder)
        raise


def _refuse(
    source: Path,
    results: Iterable[tuple[Path, str]],
    own: Mapping[str, list[int]],
    *,
    force: bool,
) -> None:
    """Refuse names that no result may have, and a workflow or scene as the input."""
    if source.suffix.lower() in {".yaml", ".yml"}:
        raise WorkflowError(
            f"{source}: this is a YAML file, and denoise takes a LAS or LAZ file; "
            "`spl-batch run` takes a workflow, `spl-batch simulate` a scene"
        )
    if source.suffix.lower() in {".h5", ".hdf5", ".he5", ".csv", ".parquet"}:
        raise WorkflowError(
            f"{source}: denoise takes a LAS or LAZ file; photons along a track (ICESat-2) need "
            f"a workflow, which `spl-batch init {source.parent}` writes"
        )
    for path, suffix in results:
        copc = path.name.lower().endswith(".copc.laz")
        if path.suffix.lower() != suffix or copc:
            but = ", and not in .copc.laz" * copc
            raise WorkflowError(f"{path}: write a name that ends in {suffix}{but}")
        if path.exists() and source.exists() and path.samefile(source):
            raise WorkflowError(f"{path}: this is the input; name another file")
        mine = path.exists() and own.get(str(real_path(path))) == [*stamp(path)]
        if path.exists() and not force and not mine:
            raise WorkflowError(f"{path} is there already; name another file, or add --force")


def _refuse_other_files(workflow: Workflow) -> None:
    """Refuse settings that ask for files beside the cloud and the terrain."""
    given = {key: getattr(workflow.outputs, key) for key in _IN_OTHER_FILES}
    asked = [f"outputs.{key}" for key, value in given.items() if value not in {None, False, "none"}]
    if asked:
        raise WorkflowError(
            f"{', '.join(asked)}: denoise writes one cloud and the terrain alone; `spl-batch init` "
            "writes a workflow, and `spl-batch run` makes these files"
        )


def _moved(folder: Path) -> Mapping[str, list[int]]:
    """Results of an earlier call that has failed in part, by their paths."""
    if folder.exists() and not (folder / _WORKFLOW).exists():
        raise WorkflowError(f"{folder}: this folder is needed for the work; rename it")
    try:
        return read_json(folder / _MOVED)
    except DamagedError:
        return {}


def _as_linear_mode(source: Path, cloud: Path, signs: str) -> str:
    """Why a file is refused that looks like linear-mode lidar, and the command that takes it."""
    command = shlex.join(
        ["spl-batch", "denoise", str(source), str(cloud), "--ground", "--set", KEEP_ALL]
    )
    return (
        f"{source}: this looks like linear-mode lidar ({signs}), and denoise would take true "
        f"points for noise; `{command}` keeps every point and finds the ground; "
        f"`spl-batch init {source.parent}` writes such a workflow for all files of its folder; if "
        f"single photons were counted, name the instrument: --sensor {SENSOR}"
    )


def _proposal(
    look: CloudLook,
    seen: Guesses,
    trajectory: Path | str | None,
    sensor: str | None,
    *,
    ground: bool,
    kept: bool,
) -> tuple[dict[str, str], dict[str, Any]]:
    """What is guessed, a sentence for each key of a workflow, and the workflow that follows.

    ``kept``: whether no point is to be filtered, so that no shots are needed.
    """
    path = look.facts.path
    if not look.facts.n_points:
        raise InputError(str(path), NO_POINTS)
    if not look.timed and not kept:
        raise InputError(
            str(path),
            "its first and last points have no usable gps_time, so there are no shots to find "
            "noise by; give the file its times, or use spl_batch.filter_points of Python, which "
            "measures noise where the cloud is empty; of linear-mode lidar, which has none, "
            f"`--ground --set {KEEP_ALL}` keeps every point and finds the ground",
        )
    channel = seen.channel
    survey: dict[str, Any] = {
        "name": path.stem,
        "flightlines": str(real_path(path)),
    }
    if sensor is not None:
        survey["sensor"] = sensor
    if channel.value is not None:
        survey["channel_dimension"] = channel.value
    if trajectory is not None:
        if not any(file.exists() for file in matching(str(trajectory), Path())):
            raise WorkflowError(f"--trajectory {trajectory}: no such file; check the path")
        survey["trajectory"] = str(real_path(trajectory))
    outputs = {"classes": "all" if ground else "noise", "catalogue": False}
    dimension = f"{channel.value} " if channel.value else ""
    reasons = {
        "survey.channel_dimension": f"beamlet numbers: {dimension}{channel.reason}",
        "survey.crs": f"CRS: {seen.crs.reason}",
    }
    if sensor is None:
        reasons["survey.sensor"] = f"sensor: {SENSOR}; --sensor names another one"
    if trajectory is None:
        reasons["survey.trajectory"] = (
            "beams: from where lines of sight meet, or vertical; --trajectory gives them"
        )
    # No raster but the terrain is delivered, so none is made of detections.
    rest = {"products": {"intensity": "las"}, "outputs": outputs, "output": "out"}
    return reasons, {"survey": survey, **rest}


def _moves(
    output: Path, delivered: Receipt, cloud: Path, raster: Path | None
) -> Iterator[tuple[Path, Path]]:
    """Each result where it was made, and where it goes; the cloud comes last."""
    if raster is not None and (output / "dtm.tif").exists():
        yield output / "dtm.tif", raster
    yield output / "laz" / delivered.facts["name"], cloud


def _counts(delivered: Receipt, *, ground: bool) -> Iterator[tuple[str, str]]:
    """How many points there are of each kind."""
    found = delivered.facts["noise_class"]
    names = {"0": "signal", "1": "background noise", "2": "afterpulses", "255": "not assessed"}
    kinds = [(name, found.get(kind, 0)) for kind, name in names.items()]
    if not kinds[-1][1]:
        del kinds[-1]
    if ground:
        kinds.append(("ground", delivered.facts["assessed"].get("2", 0)))
    dropped = sum(delivered.facts.get("dropped", {}).values())
    whole = delivered.points + dropped
    for label, value in count_rows(whole, delivered.points, kinds, dropped):
        yield label, as_ascii(value)
