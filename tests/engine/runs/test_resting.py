"""A finished run is found finished without a look at its receipts, and only while it is."""

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from spl_batch import api
from spl_batch.engine.store.working_store import Store, read_receipts
from spl_batch.engine.tasks.task import Receipt
from spl_batch.engine.verbs import output_owner
from spl_batch.engine.verbs.graph import Worklist
from spl_batch.engine.verbs.running import REST
from tests import surveys


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("resting")
    surveys.write_cloud(folder / "lines/1.laz", surveys.flightline(shots=60))
    workflow = surveys.write_workflow(folder)
    assert api.run(workflow, workers=0).exit_status == 0
    return workflow


def looked(workflow: Path, monkeypatch: pytest.MonkeyPatch) -> bool:
    """Whether a run looks at receipts."""
    looks: list[str] = []
    look = Worklist.look

    def counted(self: Worklist) -> object:
        looks.append(self.step.name)
        return look(self)

    def read(store: Store, kind: str) -> Iterator[Receipt]:
        looks.append(kind)
        return read_receipts(store, kind)

    with monkeypatch.context() as patch:
        patch.setattr(Worklist, "look", counted)
        patch.setattr(output_owner, "read_receipts", read)
        assert api.run(workflow, workers=0).exit_status == 0
    return bool(looks)


def touch(path: Path) -> None:
    os.utime(path, (0, 0))


@pytest.mark.parametrize(
    ("name", "harm"),
    [
        ("lines/1.laz", touch),
        ("out/dtm.tif", Path.unlink),
        ("out/report.html", touch),
        (f"out/store/{REST}", Path.unlink),
    ],
)
def test_what_has_changed_is_looked_at(
    finished: Path, monkeypatch: pytest.MonkeyPatch, name: str, harm: Callable[[Path], None]
) -> None:
    assert not looked(finished, monkeypatch)
    harm(finished.parent / name)
    assert looked(finished, monkeypatch)
    assert not looked(finished, monkeypatch)


def test_a_file_that_is_gone_from_the_store_is_missed(
    finished: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    next((finished.parent / "out/store/tiles").iterdir()).unlink()
    assert looked(finished, monkeypatch)
