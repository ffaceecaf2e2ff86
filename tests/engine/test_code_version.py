"""Which code a receipt's key holds: that of the receiver's tasks, all of it and no other."""

import subprocess
import sys
from pathlib import Path

import pytest

import spl_batch
from spl_batch.engine.tasks import runner
from spl_batch.engine.tasks.runner import task_files
from spl_batch.imports import data_files, imported, module_file
from spl_batch.receivers import HOMES, steps

PACKAGE = Path(spl_batch.__file__).parent

LOADED = """
import sys
from spl_batch.receivers import steps
for kind in steps(sys.argv[1]).values():
    kind.loaded()
names = [name for name in sys.modules if name.split(".")[0] == "spl_batch"]
print("\\n".join(str(sys.modules[name].__file__) for name in names))
"""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A package with rooms, one of them in another."""
    sources = {
        "__init__": "",
        "task": "from project.room import step\nfrom .beside import value as other",
        "beside": "def f():\n    import project.late",
        "late": "",
        "alone": "import project.task",
        "room/__init__": "",
        "room/step": "from project.room.inner.kernel import (\n    first,  # why\n    second,\n)",
        "room/inner/__init__": "from ... import top",
        "room/inner/kernel": 'FILE = "table.json"\nOTHER = "none.json"',
        "top": "",
    }
    for name, source in sources.items():
        path = tmp_path / "project" / f"{name}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(source)
    (tmp_path / "project/room/inner/table.json").write_text("{}")
    return tmp_path / "project"


def test_files_are_followed_into_folders_functions_and_relative_imports(package: Path) -> None:
    found = imported(package / "task.py", package)
    names = {str(path.relative_to(package).with_suffix("")) for path in found}
    assert names == {
        *("__init__", "task", "beside", "late", "top"),
        *("room/__init__", "room/step", "room/inner/__init__", "room/inner/kernel"),
    }
    assert data_files(package / "room/inner/kernel.py") == {package / "room/inner/table.json"}


@pytest.mark.parametrize("receiver", HOMES)
def test_all_that_tasks_load_is_hashed(receiver: str) -> None:
    done = subprocess.run(  # noqa: S603 - this Python, this text
        [sys.executable, "-c", LOADED, receiver],
        capture_output=True,
        text=True,
        check=True,
        cwd=PACKAGE.parent,
    )
    loaded = {Path(line) for line in done.stdout.splitlines()}
    assert len(loaded) > 30
    assert loaded <= task_files(receiver)


@pytest.mark.parametrize("receiver", HOMES)
def test_code_of_simulators_and_of_other_receivers_is_not(receiver: str) -> None:
    names = {str(path.relative_to(PACKAGE)) for path in task_files(receiver)}
    own = str(module_file(next(iter(steps(receiver).values())).modules[0]))
    rooms = ("airborne/", "altimetry/", "geiger/coincidence/", "geiger/water/")
    others = tuple(room for room in rooms if room not in own)
    assert not [name for name in names if name.startswith(others)]
    assert not [name for name in names if "simulate" in name or name.split("/")[0] == "cli"]


def test_a_change_changes_the_version(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    before = runner.code_version("altimetry")
    more = tmp_path / "more.py"
    more.write_text("")
    files = task_files("altimetry")
    monkeypatch.setattr(runner, "task_files", lambda _: files | {more})
    runner.code_version.cache_clear()
    assert runner.code_version("altimetry") != before
    runner.code_version.cache_clear()
