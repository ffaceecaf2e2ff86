"""Rooms and what they may import; dask in one folder; kernels alone; folders and modules small.

One rule: engine, lattice, numerics and formats import no receiver; receivers import no other
receiver; inside a receiver data flows one way.
"""

import ast
import itertools
import re
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from collections.abc import Set as AbstractSet
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "spl_batch"

RECEIVERS = ("airborne", "altimetry", "geiger.coincidence", "geiger.water")

FOUNDATION: Mapping[str, AbstractSet[str]] = {
    "numerics": {"names"},
    "lattice": {"names", "numerics"},
    "formats": {"names", "lattice"},
    "engine": {"names", "lattice", "formats"},
}
"""What the rooms below the receivers import beside themselves."""

NAMES = {"constants", "errors", "imports", "receivers", "__init__"}
"""Modules of the package itself that every room may import: they import no room."""

FLOW: Mapping[str, tuple[str, ...]] = {
    "airborne": (
        *("sensors", "settings", "context", "store", "beams", "noise", "afterpulse", "filter"),
        *("ground", "strips", "products", "pulses", "classes", "hydro", "accuracy"),
        *("catalogue", "simulate", "tasks", "plan", "arrays", "report", "precompile", "receiver"),
        *("compare", "quickstart", "first_use"),
    ),
    "altimetry": (
        *("settings", "photon_table", "formats", "simulate", "water", "noise", "filter", "ground"),
        *("tasks", "plan", "first_look", "report", "receiver", "compare", "first_use"),
    ),
    "geiger.coincidence": (
        *("settings", "tables", "formats", "surface", "simulate"),
        *("tasks", "plan", "report", "receiver"),
    ),
    "geiger.water": (
        *("settings", "pixel_geometry", "formats", "simulate", "ranges", "surface", "accuracy"),
        *("tasks", "plan", "calibration_targets", "report", "receiver"),
    ),
}
"""Rooms of each receiver in the order in which data flows: a room imports those before it."""

DASK = "spl_batch.engine.flow"
COMPILED = "spl_batch.numerics.compiled"
MAX_MODULES = 15
MAX_LINES = 400


def modules() -> list[Path]:
    return sorted(p for p in PACKAGE.rglob("*.py") if not p.name.startswith("."))


def dotted(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


ALL = frozenset(map(dotted, modules()))


@cache
def tree_of(text: str) -> ast.Module:
    """Syntax tree of a module's text, which several tests look at."""
    return ast.parse(text)


def imported(path: Path, text: str) -> Iterator[str]:
    """Every module that a module's text imports, inside functions as well."""
    package = dotted(path).split(".")
    if path.name != "__init__.py":
        package = package[:-1]
    for node in ast.walk(tree_of(text)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            module = ".".join([*base, *([node.module] if node.module else [])])
            for alias in node.names:
                below = f"{module}.{alias.name}"
                yield below if below in ALL or module == "spl_batch" else module


def area(name: str) -> str:
    """Receiver or room of the foundation that a module lies in; ``names`` for what all share."""
    below = name.removeprefix("spl_batch").removeprefix(".")
    for receiver in RECEIVERS:
        if f"{below}.".startswith(f"{receiver}."):
            return receiver
    first = below.split(".")[0]
    if first in FOUNDATION or first in {"api", "cli", "__main__", "geiger"}:
        return first
    return "names"


def room(name: str) -> str:
    """Room of a receiver that a module lies in; empty for the receiver's own ``__init__``."""
    return name.removeprefix(f"spl_batch.{area(name)}").removeprefix(".").split(".")[0]


def faults(path: Path, text: str) -> list[str]:
    """What a module imports and must not."""
    mine, found = dotted(path), []
    names = set(imported(path, text))
    kernel = COMPILED in names and re.search(r"^@njit\b", text, re.MULTILINE)
    for name in sorted(names):
        if name.split(".")[0] in {"dask", "distributed"} and not mine.startswith(DASK):
            found.append(f"{name}: only {DASK} imports dask")
        if name.split(".")[0] == "spl_batch":
            found += [f"{name}: {fault}" for fault in _fault(mine, name)]
            if kernel and not _may_call(name):
                found.append(f"{name}: kernels import kernels, numerics and constants only")
    return found


def _fault(mine: str, name: str) -> Iterator[str]:
    here, there = area(mine), area(name)
    if there in RECEIVERS and there != here and (here in RECEIVERS or here in FOUNDATION):
        yield "a receiver"
    elif here == there and here in RECEIVERS:
        order = FLOW[here]
        if room(mine) and room(name) and order.index(room(name)) > order.index(room(mine)):
            yield f"against the flow, {room(name)} comes after {room(mine)}"
    elif here != there and there not in FOUNDATION.get(here, {there}):
        yield f"{here} does not import {there}"
    elif here in RECEIVERS and there in {"api", "cli", "__main__"}:
        yield f"{there} is above the receivers"


@cache
def _may_call(name: str) -> bool:
    """Whether a kernel may import a module: all that it imports are numerics and constants."""
    if area(name) in {"numerics", "names"}:
        return True
    path = ROOT.joinpath(*name.split(".")).with_suffix(".py")
    if area(name) not in RECEIVERS or not path.is_file():
        return False
    names = imported(path, path.read_text(encoding="utf-8"))
    return all(_may_call(below) for below in names if below.split(".")[0] == "spl_batch")


def cycle(graph: Mapping[str, AbstractSet[str]]) -> list[str]:
    """Modules that import one another in a circle; empty where none do."""
    left = {name: set(below) & set(graph) - {name} for name, below in graph.items()}
    while done := {name for name, below in left.items() if not below}:
        left = {name: below - done for name, below in left.items() if name not in done}
    return sorted(left)


def crowded(files: list[Path]) -> list[str]:
    """Folders with more modules than one looks through."""
    count = Counter(path.parent for path in files if path.name != "__init__.py")
    return [f"{folder}: {n}" for folder, n in sorted(count.items()) if n > MAX_MODULES]


@pytest.mark.parametrize("path", modules(), ids=dotted)
def test_imports_keep_the_rule(path: Path) -> None:
    assert faults(path, path.read_text(encoding="utf-8")) == []


def test_nothing_is_imported_in_a_circle() -> None:
    graph = {dotted(p): set(imported(p, p.read_text(encoding="utf-8"))) for p in modules()}
    assert cycle(graph) == []


def test_every_room_has_its_place_in_the_flow() -> None:
    rooms = defaultdict(set)
    for name in ALL:
        if area(name) in RECEIVERS and room(name):
            rooms[area(name)].add(room(name))
    assert {name: found - set(FLOW[name]) for name, found in rooms.items()} == {
        name: set() for name in RECEIVERS
    }
    tops = {name.split(".")[1] for name in ALL if "." in name}
    assert tops <= {*FOUNDATION, *NAMES, "api", "cli", "__main__", "geiger", *RECEIVERS}


@pytest.mark.parametrize("tree", ["spl_batch", "tests", "benchmarks"])
def test_no_folder_is_crowded(tree: str) -> None:
    assert crowded(sorted((ROOT / tree).rglob("*.py"))) == []


@pytest.mark.parametrize("path", modules(), ids=dotted)
def test_modules_are_short_and_have_a_purpose(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert len(text.splitlines()) < MAX_LINES
    assert path.stem not in {"utils", "util", "helpers", "misc", "common"}
    assert ast.get_docstring(tree_of(text)), "a module opens with what it is for"


KERNEL = "from spl_batch.numerics.compiled import njit\n{}\n@njit()\ndef f(): ...\n"


@pytest.mark.parametrize(
    ("module", "text", "good"),
    [
        ("engine/tasks/runner.py", "from spl_batch.airborne import context", False),
        ("engine/tasks/runner.py", "from spl_batch.airborne.context import Context", False),
        ("engine/tasks/runner.py", "from spl_batch.geiger.water import plan", False),
        ("engine/tasks/runner.py", "from ..store.working_store import Store", True),
        ("engine/tasks/runner.py", "import spl_batch.altimetry.plan", False),
        ("formats/las/reader.py", "from spl_batch.engine.tasks.task import Task", False),
        ("formats/las/reader.py", "from spl_batch.errors import InputError", True),
        ("lattice/tiles.py", "from spl_batch.formats import crs", False),
        ("numerics/poisson.py", "def f():\n    from spl_batch.lattice import tiles", False),
        ("altimetry/plan.py", "from spl_batch.airborne.plan import cost", False),
        ("geiger/water/plan.py", "from spl_batch.geiger.coincidence import plan", False),
        ("geiger/water/plan.py", "from spl_batch.engine.plan.budget import Cost", True),
        ("airborne/noise/gate.py", "from spl_batch.airborne.filter import denoise", False),
        ("airborne/noise/gate.py", "from ..filter.denoise import denoise", False),
        ("airborne/filter/denoise.py", "from spl_batch.airborne.noise import gate", True),
        ("airborne/tasks/index.py", "from spl_batch.airborne.plan import cost", False),
        ("airborne/receiver.py", "from spl_batch import api", False),
        ("api/__init__.py", "from spl_batch.airborne.quickstart import quickstart", True),
        ("airborne/tasks/index.py", "def f():\n    import dask.array", False),
        ("engine/flow/cluster.py", "import distributed", True),
        (
            "airborne/ground/ptd.py",
            KERNEL.format("from spl_batch.lattice.tables import rows_of"),
            False,
        ),
        (
            "airborne/ground/ptd.py",
            KERNEL.format("from spl_batch.airborne.settings import Section"),
            False,
        ),
        ("airborne/ground/ptd.py", KERNEL.format("from spl_batch.constants import NODATA"), True),
        (
            "airborne/ground/ptd.py",
            KERNEL.format("from spl_batch.airborne.ground import pits"),
            True,
        ),
        ("airborne/ground/ground_methods.py", "from spl_batch.lattice.tables import rows_of", True),
    ],
)
def test_the_walk_finds_what_it_should(module: str, text: str, good: bool) -> None:  # noqa: FBT001
    assert (faults(PACKAGE / module, text) == []) is good


def test_circles_and_crowds_are_found() -> None:
    assert cycle({"a": {"b", "os"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}) == ["a", "b", "c", "d"]
    assert cycle({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == []
    files = [Path(f"full/{k}.py") for k in range(MAX_MODULES + 1)]
    beside = [Path("full/__init__.py"), *(Path(f"room/{k}.py") for k in range(MAX_MODULES))]
    assert crowded([*itertools.chain(files, beside)]) == [f"full: {MAX_MODULES + 1}"]
