"""Compiled code that several processes keep at the same time."""

import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from numba.core.caching import IndexDataCacheFile

import spl_batch.kernels  # noqa: F401 - has numba save code as the project does

WRITERS = 4


@pytest.fixture
def slow(monkeypatch: pytest.MonkeyPatch) -> Iterator[threading.Barrier]:
    """An index that all who may read it at the same time do."""
    together = threading.Barrier(WRITERS)
    load = IndexDataCacheFile._load_index

    def loaded(self: Any) -> dict[Any, str]:
        found: dict[Any, str] = load(self)
        try:
            together.wait(0.2)
        except threading.BrokenBarrierError:
            together.reset()
        return found

    with monkeypatch.context() as patched:
        patched.setattr(IndexDataCacheFile, "_load_index", loaded)
        yield together


def kept(folder: Path) -> IndexDataCacheFile:
    """What another process sees of a function's code."""
    return IndexDataCacheFile(str(folder), "module.function", "stamp")


@pytest.mark.usefixtures("slow")
def test_writers_at_the_same_time_lose_and_mix_nothing(tmp_path: Path) -> None:
    writers = [
        threading.Thread(target=kept(tmp_path).save, args=(f"types {k}", f"code {k}"))
        for k in range(WRITERS)
    ]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
    assert [kept(tmp_path).load(f"types {k}") for k in range(WRITERS)] == [
        f"code {k}" for k in range(WRITERS)
    ]


def test_what_was_not_written_is_not_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    earlier = IndexDataCacheFile(str(tmp_path), "module.function", "earlier stamp")
    earlier.save("types", "earlier code")

    def killed(*_: Any) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(IndexDataCacheFile, "_save_data", killed)
        with pytest.raises(KeyboardInterrupt):
            kept(tmp_path).save("types", "code")
    assert kept(tmp_path).load("types") is None
    kept(tmp_path).save("types", "code")
    kept(tmp_path).save("types", "better code")
    kept(tmp_path).save("others", "code of others")
    assert kept(tmp_path).load("types") == "better code"
    assert kept(tmp_path).load("others") == "code of others"
    assert earlier.load("types") is None
