"""The filters that this installation knows, and what each says about a simulated survey.

``judge`` runs the chain up to the filter with a method's settings and gives the noise class of
every return in the order of the survey's files; the shots are gathered once for each way of
treating them and linked into each method's own folder, as receipts show what is finished.
"""

import hashlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, get_args

import laspy
import numpy as np
import pyarrow.parquet as pq
from numpy.typing import NDArray

from spl_batch import api
from spl_batch.airborne.compare.comparison import PUBLISHED_FILTER, PUBLISHED_NOISE
from spl_batch.airborne.settings import FilterSettings
from spl_batch.airborne.settings.workflow import Workflow, load_workflow
from spl_batch.airborne.simulate import simulate
from spl_batch.airborne.simulate.scene.scene_file import Scene
from spl_batch.airborne.steps import STEPS
from spl_batch.engine.plan.input_files import source_key
from spl_batch.engine.store.links import share_finished
from spl_batch.engine.store.working_store import Store
from spl_batch.formats.verified.parquet_npz import read_columns

KINDS = ("background", "ground", "roof", "vegetation", "wire", "water", "afterpulse", "other")
BACKGROUND, GROUND, ROOF, VEGETATION, WIRE, WATER, AFTERPULSE, OTHER = range(len(KINDS))

Columns = dict[str, NDArray[Any]]

SHARED = tuple(name for name, step in STEPS.items() if step.stage in {"index", "shots"})
"""Kinds of tasks that do not depend on the filter."""


@dataclass(frozen=True, slots=True)
class Method:
    """One filter with its settings.

    Parameters
    ----------
    label : str
        How tables call it.
    settings : tuple of str
        ``key.path=value`` of the filter.
    shots : tuple of str
        The same of the steps before it; methods that share them share their work.
    alone : bool
        Whether each flightline is filtered by itself, as [W17] ch. 5 does.
    claims : mapping
        Effective settings that its row in a table stands for, as :func:`effective` names them.
    """

    label: str
    settings: tuple[str, ...]
    shots: tuple[str, ...] = ()
    alone: bool = False
    claims: Mapping[str, object] = field(default_factory=dict)


AS_W18: dict[str, object] = {
    "filter.method": "vsaes", "filter.test": "published", "filter.neighbours": 15,
    "filter.radius_m": 1.5, "noise.correction": "published",
}  # fmt: skip
"""Effective settings of [W18]'s filter, and of [W17] ch. 6's, which takes more neighbours."""

AS_W17: dict[str, object] = {**AS_W18, "filter.neighbours": 25}

NO_RULE: dict[str, object] = {"afterpulse.enabled": False}
BY_PLANE: dict[str, object] = {"afterpulse.enabled": True, "afterpulse.method": "published"}
BY_BEAMLET: dict[str, object] = {"afterpulse.enabled": True, "afterpulse.method": "beamlet"}
"""The same of the rules for afterpulses: none, [W17] ch. 7's, ours."""

OWN_FILTER: dict[str, object] = {
    "filter.method": "vsaes", "filter.test": "calibrated", "noise.correction": "seen",
    "filter.neighbours": 25,
}  # fmt: skip
"""The same of our filter."""

PUBLISHED_PLANE = ("noise.correction=published", "afterpulse.method=published")
"""Steps before the filter as in [W17] ch. 7."""

W17_FILTER = (*PUBLISHED_FILTER, "filter.neighbours=25")
"""The filter of [W17] ch. 6 and 7."""


OF_VSAES = ("test", "alpha", "neighbours", "radius_m")
"""Keys of ``filter`` that the sources' other filters do not look at."""


def effective(workflow: Workflow) -> dict[str, object]:
    """Settings that a run acts on, by key: those of methods that are not chosen are left out."""
    given = workflow.model_dump()
    ground, chosen, rule = given["ground"], given["filter"], given["afterpulse"]
    given["ground"] = {k: v for k, v in ground.items() if not _is_other(k, v, ground["method"])}
    own = chosen["method"] == "vsaes"
    section = "wires" if own and chosen["test"] != "published" else chosen["method"]
    given["filter"] = {
        k: v
        for k, v in chosen.items()
        if not _is_other(k, v, section) and (own or k not in OF_VSAES)
    }
    idle = {"lag_max_m", "vegetation_loss"} if rule["method"] == "published" else set()
    acting = rule.keys() - idle if rule["enabled"] else {"enabled"}
    given["afterpulse"] = {k: v for k, v in rule.items() if k in acting}
    return dict(_flat(given))


def _is_other(name: str, value: object, method: str) -> bool:
    """Whether a key is the section of a method that is not chosen."""
    return isinstance(value, dict) and name != method


def _flat(section: Mapping[str, Any], place: str = "") -> Iterator[tuple[str, object]]:
    """Keys of a section and those within it, with their values."""
    for name, value in section.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{place}{name}.")
        else:
            yield place + name, value


def unmet(
    workflow: Path, overrides: Sequence[str], claims: Mapping[str, object]
) -> dict[str, object]:
    """Claims of a row that its run does not meet, with what acts; overrides without effect."""
    acting = effective(load_workflow(workflow, overrides))
    wrong = {k: acting.get(k) for k, v in claims.items() if k not in acting or acting[k] != v}
    names = [override.partition("=")[0] for override in overrides]
    return wrong | {name: None for name in names if name not in acting}


def check(workflow: Path, overrides: Sequence[str], claims: Mapping[str, object]) -> None:
    """Stop where a run would not be what its row in a table stands for."""
    if wrong := unmet(workflow, overrides, claims):
        raise SystemExit(f"{workflow}: not what the row claims, or without effect: {wrong}")


LEFT_IN = ("afterpulse.enabled=false",)
"""Steps before the sources' filters: none of them takes afterpulses out first. VSAES alone has the
published gamma of [W18] Eq. 2 as well. AES draws the number of noise returns from where there is no
signal [W17 Eq. 4.1]; gamma's factor of two would make it throw half of the signal away."""


def is_noise(kind: NDArray[np.integer[Any]]) -> NDArray[np.bool_]:
    """Which returns no surface reflected, by their true kind: (n,)."""
    return np.isin(kind, (BACKGROUND, AFTERPULSE))


def known_methods() -> dict[str, Method]:
    """Every filter of this installation by name; the sources' with the sources' steps before."""
    found = {
        "published": Method(
            "VSAES, as published", PUBLISHED_FILTER, PUBLISHED_NOISE, claims=AS_W18 | NO_RULE
        )
    }
    for name in _choices("method"):
        if name not in {"vsaes", "none"}:
            said = {"filter.method": name, "noise.correction": "seen", **NO_RULE}
            one = Method(name.upper(), (f"filter.method={name}",), LEFT_IN, claims=said)
            found[name] = replace(one, label=f"{one.label}, merged") if name == "aes" else one
    if "aes" in found:
        found["aes_alone"] = replace(found["aes"], label="AES, lines alone", alone=True)
    found["published_alone"] = replace(found["published"], label="VSAES, lines alone", alone=True)
    scan = "wires" in FilterSettings.model_fields
    alone, with_scan = (
        ((f"filter.wires.enabled={word}",) if scan else ()) for word in ("false", "true")
    )
    own = {**OWN_FILTER, **BY_BEAMLET}
    if "calibrated" in _choices("test"):
        test = ("filter.method=vsaes", "filter.test=calibrated")
        found["calibrated"] = Method("calibrated", (*test, *alone), claims=own)
        label = "calibrated + wire scan" if scan else "calibrated"
        found["ours"] = Method(label, (*test, *with_scan), claims=own)
    return found


def _choices(key: str) -> tuple[str, ...]:
    return get_args(FilterSettings.model_fields[key].annotation)


def make_survey(scene: Scene, folder: Path) -> Path:
    """Simulate a scene into a folder unless it is there; the folder."""
    if not (folder / "workflow.yaml").exists():
        simulate(scene, folder)
    return folder


def load_truth(survey: Path) -> Columns:
    """Every return of a survey with its truth: x, y, z [m], line, kind, parent, parent_row."""
    parts: dict[str, list[NDArray[Any]]] = {}
    start = 0
    for path in flightlines(survey):
        table = pq.read_table(survey / "truth" / f"{path.stem}.parquet")
        columns = {name: table[name].to_numpy() for name in table.column_names}
        rows = columns["parent_row"]
        columns["parent_row"] = np.where(rows >= 0, rows + start, -1)
        las = laspy.read(path)
        columns |= {axis: np.asarray(las[axis], dtype=np.float64) for axis in "xyz"}
        columns["line"] = np.asarray(las.point_source_id)
        columns["gps_time"] = np.asarray(las.gps_time)
        start += len(las)
        for name, values in columns.items():
            parts.setdefault(name, []).append(values)
    return {name: np.concatenate(values) for name, values in parts.items()}


def judge(survey: Path, method: Method) -> NDArray[np.uint8]:
    """Noise class of every return, in the order of :func:`load_truth`.

    Parameters
    ----------
    survey : Path
        Folder of a simulated survey.
    method : Method
        The filter.
    """
    files = flightlines(survey)
    if not method.alone:
        return _run(survey, method, output_name(method), files)
    return np.concatenate([
        _run(survey, method, f"{output_name(method)}_{path.stem}", [path],
             f"survey.flightlines=flightlines/{path.name}")
        for path in files
    ])  # fmt: skip


def _run(
    survey: Path, method: Method, output: str, files: list[Path], *more: str
) -> NDArray[np.uint8]:
    overrides = (*method.shots, *method.settings, *more)
    check(survey / "workflow.yaml", overrides, method.claims)
    digest = hashlib.blake2b(repr(method.settings).encode(), digest_size=4).hexdigest()
    own = f"{output}_{digest}"
    _finish(survey, method, output, "shots", *method.shots, *more)
    share_finished(Store(survey / output), Store(survey / own), SHARED)
    _finish(survey, method, own, "denoise", *overrides)
    return _read_labels(files, Store(survey / own))


def _finish(survey: Path, method: Method, output: str, until: str, *settings: str) -> None:
    overrides = [*settings, f"output={output}"]
    result = api.run(survey / "workflow.yaml", overrides=overrides, until=until, workers=0)
    if result.exit_status:
        raise SystemExit(f"{survey}: the run with {method.label} failed; see {output}/log.jsonl")


def output_name(method: Method) -> str:
    """Folder of the steps before the filter, which methods may share.

    Labels lie in a folder of each method's own: a filter that looks less far has other blocks, and
    those of another one would be read with them.
    """
    changed = [setting.partition("=")[0].rpartition(".")[2] for setting in method.shots]
    return "_".join(["out", *changed])


def flightlines(survey: Path) -> list[Path]:
    """Files of a simulated survey, in the order that all benchmarks use."""
    return sorted((survey / "flightlines").glob("line_*.laz"))


def _read_labels(files: list[Path], store: Store) -> NDArray[np.uint8]:
    with_counts = [(path, _points(path)) for path in files]
    first = np.cumsum([0, *(n for _, n in with_counts)])
    start = {
        source_key(f"flightlines/{path.name}"): int(k)
        for path, k in zip(files, first[:-1], strict=True)
    }
    out = np.full(int(first[-1]), 255, dtype=np.uint8)
    rows_of = {path.stem: _global_rows(path, start) for path in store.path("tiles").glob("*")}
    for path in store.path("noise").glob("*.parquet"):
        names = ("tile_i", "tile_j", "row", "noise_class")
        table = read_columns(path, names)
        i, j, row, label = (table[name] for name in names)
        for tile in np.unique(np.column_stack([i, j]), axis=0):
            mine = (i == tile[0]) & (j == tile[1])
            out[rows_of[f"{tile[0]}_{tile[1]}"][row[mine]]] = label[mine]
    return out


def _points(path: Path) -> int:
    with laspy.open(path) as reader:
        return int(reader.header.point_count)


def _global_rows(path: Path, start: dict[int, int]) -> NDArray[np.int64]:
    table = pq.read_table(path, columns=["source", "index"])
    source, index = table["source"].to_numpy(), table["index"].to_numpy()
    rows: NDArray[np.int64] = index.astype(np.int64)
    for key, first in start.items():
        rows[source == np.uint64(key)] += first
    return rows


def share(part: NDArray[np.bool_], of: NDArray[np.bool_]) -> float:
    """Percentage of ``of`` that is in ``part``; NaN where there is none."""
    return 100.0 * float(part[of].mean()) if of.any() else float("nan")


def pooled(values: Iterable[tuple[int, int]]) -> float:
    """Percentage of counts (part, whole) summed over seeds."""
    part, whole = (sum(v) for v in zip(*values, strict=True))
    return 100.0 * part / whole if whole else float("nan")
