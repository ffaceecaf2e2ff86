"""The filters that this installation knows, and what each makes of a simulated survey."""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
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

KINDS = ("background", "ground", "roof", "vegetation", "wire", "water", "afterpulse", "other")
BACKGROUND, GROUND, ROOF, VEGETATION, WIRE, WATER, AFTERPULSE, OTHER = range(len(KINDS))

Columns = dict[str, NDArray[Any]]


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
        Whether each half of the scan of each flightline is filtered by itself, fore and aft, as
        [W17] 6.1 and [W18] 2.1 do.
    claims : mapping
        Effective settings that its row in a table names, as :func:`effective` names them.
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


def _flat(section: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, object]]:
    """Keys of a section and those within it, with their values."""
    for name, value in section.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield prefix + name, value


def unmet(
    workflow: Path, overrides: Sequence[str], claims: Mapping[str, object]
) -> dict[str, object]:
    """Claims of a row that its run does not meet, with what acts; overrides without effect."""
    acting = effective(load_workflow(workflow, overrides))
    wrong = {k: acting.get(k) for k, v in claims.items() if k not in acting or acting[k] != v}
    names = [override.partition("=")[0] for override in overrides]
    return wrong | {name: None for name in names if name not in acting}


def check(workflow: Path, overrides: Sequence[str], claims: Mapping[str, object]) -> None:
    """Stop where a run would not be what its row in a table names."""
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
            claims = {"filter.method": name, "noise.correction": "seen", **NO_RULE}
            one = Method(name.upper(), (f"filter.method={name}",), LEFT_IN, claims=claims)
            found[name] = replace(one, label=f"{one.label}, merged") if name == "aes" else one
    if "aes" in found:
        found["aes_alone"] = replace(found["aes"], label="AES, halves alone", alone=True)
    found["published_alone"] = replace(found["published"], label="VSAES, halves alone", alone=True)
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
    digest = hashlib.blake2b(repr((method.shots, method.settings)).encode(), digest_size=4)
    output = f"out_{digest.hexdigest()}"
    if not method.alone:
        return _run(survey, method, output, flightlines(survey))
    found = []
    for path in flightlines(survey):
        fore = _looks_ahead(survey, path)
        labels = np.empty(len(fore), np.uint8)
        for name, rows in (("fore", fore), ("aft", ~fore)):
            half = survey / "halves" / f"{path.stem}_{name}.laz"
            if not half.exists():
                half.parent.mkdir(exist_ok=True)
                las = laspy.read(path)
                las.points = las.points[rows]
                las.write(half)
            labels[rows] = _run(survey, method, f"{output}_{half.stem}", [half])
        found.append(labels)
    return np.concatenate(found)


def _looks_ahead(survey: Path, path: Path) -> NDArray[np.bool_]:
    """Which returns of a flightline lie forward of the sensor: (n,)."""
    time_s, *track = np.loadtxt(survey / "trajectory.csv", delimiter=",", skiprows=1).T[:3]
    las = laspy.read(path)
    at = np.asarray(las.gps_time)
    forward = np.zeros(len(at))
    for values, axis in zip(track, "xy", strict=True):
        way = np.interp(at + 0.5, time_s, values) - np.interp(at - 0.5, time_s, values)
        forward += way * (np.asarray(las[axis]) - np.interp(at, time_s, values))
    return forward > 0


def _run(survey: Path, method: Method, output: str, files: list[Path]) -> NDArray[np.uint8]:
    """Noise classes that a run delivers."""
    folder = files[0].parent.name
    names = files[0].name if len(files) == 1 else "line_*.laz"
    overrides = [*method.shots, *method.settings, f"survey.flightlines={folder}/{names}"]
    check(survey / "workflow.yaml", overrides, method.claims)
    overrides += [f"output={output}", "reference=null"]
    result = api.run(survey / "workflow.yaml", overrides=overrides, until="deliver", workers=0)
    if result.exit_status:
        raise SystemExit(f"{survey}: the run with {method.label} failed; see {output}/log.jsonl")
    clouds = [survey / output / "laz" / folder / path.name for path in files]
    return np.concatenate([np.asarray(laspy.read(path)["noise_class"]) for path in clouds])


def flightlines(survey: Path) -> list[Path]:
    """Files of a simulated survey, in the order that all benchmarks use."""
    return sorted((survey / "flightlines").glob("line_*.laz"))
