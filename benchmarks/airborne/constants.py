"""Half and twice of each numeric constant: what moves on two unlike scenes.

Run ``python -m benchmarks.airborne.constants ROOM ... [--only NAME ...]``, a room being a folder or
a module of ``spl_batch/airborne``, such as ``lines`` or ``beams/geometry``.

Prints a line for each constant, value and scene: labels, cells of each raster and leaves of the
report that move. Nothing after a scene's name says that nothing moved. What a kernel has compiled
into it is named and left out: it takes an edit and another run. Constants of tuples are scaled as a
whole. ``docs/evidence/constants.md`` holds what followed.
"""

import argparse
import ast
import importlib
import json
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import laspy
import numpy as np
import rasterio
from numpy.typing import NDArray

import spl_batch
from benchmarks.held import scenes
from benchmarks.held.surveys import simulated
from spl_batch import api
from spl_batch.errors import SplBatchError

Content = dict[str, Any]

ROOT = Path(spl_batch.__file__).parent

HAZE: Final[Content] = {
    **scenes.SKY,
    "name": "haze",
    "extent_m": [60, 60],
    "acquisition": {"prf_hz": 20000, "gate_m": 150},
    "sky": {**scenes.SKY["sky"], **scenes.SKIES["haze 25-45 m, 30 x"]},
}

WATER: Final[Content] = {
    "name": "water",
    "extent_m": [60, 60],
    "seed": 5,
    "terrain": {"relief_m": 12, "wavelength_m": 80},
    "buildings": {"count": 3},
    "trees": {"cover": 0.3},
    "water": [{"ring_m": [[35, 5], [55, 5], [55, 25], [35, 25]], "depth_m": 1.5}],
    "wires": [
        {
            "kind": "transmission",
            "points_m": [[-60, 40], [170, 50]],
            "height_m": 18,
            "sag_m": 3,
            "returns_per_m": 0.8,
        }
    ],
    "flights": [*scenes.SKY["flights"], scenes.THIRD],
    "sky": {"background_per_m3": 0.03},
    "acquisition": {"prf_hz": 20000, "gate_m": 200},
}

SCENES: Final[Mapping[str, tuple[Content, tuple[str, ...]]]] = {
    "haze": (HAZE, ()),
    "water": (WATER, ()),
    "no-trajectory": (WATER, ("survey.trajectory=null",)),
}
"""Scenes by name, and what their workflows are overridden with."""

APART = ("performance", "run", "software", "time", "provenance")
"""Parts of a report that differ between two runs of the same survey."""


class Delivered(NamedTuple):
    """What a run delivered: labels of all returns, rasters by name, leaves of the report."""

    labels: NDArray[np.uint8]
    rasters: dict[str, NDArray[np.float64]]
    report: dict[str, str]


def main(arguments: Sequence[str] | None = None) -> int:
    """Sweep the constants of the rooms and print what moves; the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.airborne.constants",
        description=(__doc__ or "").split("\n", maxsplit=1)[0],
    )
    parser.add_argument("rooms", nargs="+", metavar="ROOM")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="only constants of these names")
    parser.add_argument(
        "--scenes", nargs="+", choices=SCENES, default=["haze", "water"], metavar="SCENE"
    )
    parser.add_argument("--folder", type=Path, help="keeps the scenes for another run")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.folder or Path(scratch)
        before = {scene: delivered(scene, folder) for scene in options.scenes}
        for room in options.rooms:
            path = ROOT / "airborne" / room
            for source in sorted(path.rglob("*.py")) or [path.with_suffix(".py")]:
                for name, compiled in constants(source):
                    if not options.only or name in options.only:
                        sweep(source, name, before, folder, compiled=compiled)
    return 0


def constants(source: Path) -> Iterator[tuple[str, bool]]:
    """Names of a module's numeric constants, and whether a kernel of it has each compiled in."""
    tree = ast.parse(source.read_text(encoding="utf-8"))
    compiled = {
        node.id
        for function in ast.walk(tree)
        if isinstance(function, ast.FunctionDef)
        and any("njit" in ast.unparse(one) for one in function.decorator_list)
        for node in ast.walk(function)
        if isinstance(node, ast.Name)
    }
    for node in tree.body:
        if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
            continue
        target = node.targets[0] if isinstance(node, ast.Assign) else node.target
        inside = list(ast.walk(node.value))
        numbers = [
            one
            for one in inside
            if isinstance(one, ast.Constant) and type(one.value) in (int, float)
        ]
        derived = any(isinstance(one, ast.Call | ast.Name) for one in inside)
        if isinstance(target, ast.Name) and numbers and not derived:
            yield target.id, target.id in compiled


def sweep(
    source: Path, name: str, before: Mapping[str, Delivered], folder: Path, *, compiled: bool
) -> None:
    """Run the scenes with half and twice of one constant, and print what moves."""
    home = ".".join(source.relative_to(ROOT.parent).with_suffix("").parts)
    value = getattr(importlib.import_module(home), name)
    title = f"{home.removeprefix('spl_batch.airborne.')} {name} {value}"
    if compiled or not isinstance(value, int | float | tuple):
        print(f"{title}: compiled into a kernel, or a table", flush=True)
        return
    users = [
        module
        for key, module in list(sys.modules.items())
        if key.startswith("spl_batch.") and getattr(module, name, None) is value
    ]
    for times in (0.5, 2.0):
        other = scaled(value, times)
        if other == value:
            continue
        for module in users:
            setattr(module, name, other)
        for scene, first in before.items():
            try:
                moved = json.dumps(difference(first, delivered(scene, folder)))
            except (ArithmeticError, LookupError, SplBatchError, ValueError) as error:
                moved = f"{type(error).__name__}: {str(error)[:100]}"
            print(f"{title} -> {other} {scene} {moved.strip('{}')}", flush=True)
        for module in users:
            setattr(module, name, value)


def scaled(value: Any, times: float) -> Any:
    """A number, or a tuple of them, times a factor; whole numbers stay whole, twice of 0 is 1."""
    if isinstance(value, tuple):
        return tuple(scaled(one, times) for one in value)
    if isinstance(value, int):
        return max(round(value * times), 0 if times < 1 else 1)
    return value * times


def delivered(scene: str, folder: Path) -> Delivered:
    """What a run of a scene with the constants as they are delivers."""
    content, overrides = SCENES[scene]
    survey = simulated(content, folder / content["name"])
    result = api.run(survey / "workflow.yaml", workers=0, fresh=True, overrides=overrides)
    out = survey / "out"
    clouds = [laspy.read(path) for path in sorted((out / "laz").rglob("*.laz"))]
    rasters = {}
    for path in sorted(out.glob("*.tif")):
        with rasterio.open(path) as raster:
            rasters[path.stem] = raster.read(1).astype(np.float64)
    report = json.loads((out / "report.json").read_text(encoding="utf-8"))
    kept = {key: part for key, part in report.items() if key not in APART}
    leaves = dict(flat({"exit": result.exit_status, **kept}))
    labels = np.concatenate([np.asarray(cloud.classification) for cloud in clouds])
    return Delivered(labels, rasters, leaves)


def flat(part: Any, key: str = "") -> Iterator[tuple[str, str]]:
    """Leaves of a report with their keys; a list is one leaf."""
    if isinstance(part, dict):
        for name, inner in part.items():
            yield from flat(inner, f"{key}.{name}")
    else:
        yield key, json.dumps(part)


def difference(first: Delivered, second: Delivered) -> dict[str, Any]:
    """Labels, cells of rasters and leaves of the report that differ; none where nothing does."""
    moved: dict[str, Any] = {"labels": apart(first.labels, second.labels)}
    for name, raster in first.rasters.items():
        other = second.rasters.get(name)
        moved[name] = "gone" if other is None else apart(raster, other)
    keys = sorted(
        key
        for key in first.report.keys() | second.report.keys()
        if first.report.get(key) != second.report.get(key)
    )
    moved["report"] = f"{len(keys)}: {', '.join(keys[:3])}" if keys else 0
    return {name: count for name, count in moved.items() if count}


def apart(first: NDArray[Any], second: NDArray[Any]) -> int | str:
    """Count of entries that differ, or that the shapes do."""
    return "shape" if first.shape != second.shape else int((first != second).sum())


if __name__ == "__main__":
    sys.exit(main())
