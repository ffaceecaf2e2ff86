"""Imports only go down, dask stays in one module, modules stay short."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "spl_batch"

STOREYS: list[set[str]] = [
    {"__main__"},
    {"cli"},
    {"api"},
    {"graph"},
    {"plan"},
    {"runner"},
    {"stages"},
    {"report", "accuracy", "simulate"},
    {"io"},
    {"kernels"},
    {"tiling"},
    {"model", "task", "products"},
    {
        *{"workflow", "settings", "sensor", "sensors", "constants", "errors", "order"},
        *{"receivers", "workflow_file", "imports", "numerics", "__init__"},
    },
]
"""Modules by storey, the top one first; a module may import its own storey and below."""

LEVEL = {name: level for level, names in enumerate(STOREYS) for name in names}

RECEIVERS = (("altimetry",), ("geiger", "coincidence"), ("geiger", "water"))
"""Packages of the other receivers: inside each, modules and folders have the storeys' names."""
MAX_LINES = 400


def modules() -> list[Path]:
    return sorted(p for p in PACKAGE.rglob("*.py") if not p.name.startswith("."))


def dotted(path: Path) -> str:
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imported(path: Path, text: str) -> Iterator[str]:
    """Every module that a module's text imports, inside functions as well."""
    package = dotted(path).split(".")
    if path.name != "__init__.py":
        package = package[:-1]
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            module = ".".join([*base, *([node.module] if node.module else [])])
            # `from spl_batch import api` names a module, not a value.
            if module == "spl_batch":
                yield from (f"{module}.{alias.name}" for alias in node.names)
            else:
                yield module


def storey(name: str) -> str:
    """Storey of a project module; names of `spl_batch` itself lie in `__init__`."""
    parts = tuple(name.split(".")[1:])
    for package in RECEIVERS:
        if parts[: len(package)] == package:
            parts = parts[len(package) :]
    return parts[0] if parts and parts[0] in LEVEL else "__init__"


def faults(path: Path, names: Iterator[str]) -> list[str]:
    """What a module imports and must not."""
    mine = storey(dotted(path)) if dotted(path) != "spl_batch" else "__init__"
    found = []
    for name in names:
        top = name.split(".")[0]
        if top in {"dask", "distributed"} and mine != "graph":
            found.append(f"{name}: only graph may import dask")
        if top != "spl_batch":
            continue
        theirs = storey(name)
        if LEVEL[theirs] < LEVEL[mine]:
            found.append(f"{name}: upwards")
        if mine == "stages" and theirs == "io":
            found.append(f"{name}: stages do no input or output")
        if mine == "stages" and theirs in {"report", "accuracy", "simulate"}:
            found.append(f"{name}: no part of a stage")
        if mine == "kernels" and theirs not in {"kernels", "constants", "numerics"}:
            found.append(f"{name}: kernels know constants, numerics and kernels only")
        if mine == "io" and theirs == "kernels":
            found.append(f"{name}: io computes nothing")
    return found


def test_every_module_has_a_storey() -> None:
    homeless = {
        dotted(path)
        for path in modules()
        if storey(dotted(path)) == "__init__" and path.name != "__init__.py"
    }
    assert homeless == set(), "give new modules a storey"


@pytest.mark.parametrize("path", modules(), ids=dotted)
def test_imports_go_down(path: Path) -> None:
    assert faults(path, imported(path, path.read_text(encoding="utf-8"))) == []


@pytest.mark.parametrize("path", modules(), ids=dotted)
def test_modules_are_short_and_have_a_purpose(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert len(text.splitlines()) < MAX_LINES
    assert path.stem not in {"utils", "util", "helpers", "misc", "common"}
    assert ast.get_docstring(ast.parse(text)), "a module opens with what it is for"


@pytest.mark.parametrize(
    ("module", "line", "good"),
    [
        ("stages/denoise.py", "from spl_batch.io.las import inspect", False),
        ("stages/denoise.py", "from spl_batch.kernels import kdtree", True),
        ("kernels/tin.py", "from spl_batch.model import PointTable", False),
        ("kernels/tin.py", "from spl_batch.constants import NODATA", True),
        ("runner/index.py", "from spl_batch import graph", False),
        ("runner/index.py", "def f():\n    import dask.array", False),
        ("graph.py", "import distributed", True),
        ("io/las.py", "from ..runner import run_task", False),
        ("io/las.py", "from . import crs", True),
        ("tiling.py", "from .workflow import Workflow", True),
        ("sensor.py", "from .tiling import quanta", False),
    ],
)
def test_the_walk_finds_what_it_should(module: str, line: str, good: bool) -> None:  # noqa: FBT001
    path = PACKAGE / module
    assert (faults(path, imported(path, line)) == []) is good


def test_kernels_take_the_projects_njit() -> None:
    """numba's own would go on with old code where only a called function has changed."""
    taken = [
        dotted(path)
        for path in modules()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ImportFrom) and node.module == "numba"
        if {alias.name for alias in node.names} & {"jit", "njit"}
    ]
    assert taken == []
