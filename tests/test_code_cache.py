"""Compiled code that is kept: by several processes at once, and as long as it is current."""

import threading
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from numba.core.caching import IndexDataCacheFile

from spl_batch.kernels import code_cache
from spl_batch.kernels.ellipsoid_walk import walk

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


def test_code_is_current_as_long_as_all_that_it_calls_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(code_cache, "_ROOT", tmp_path)
    monkeypatch.setattr(code_cache, "_PACKAGE", "project")
    sources = {
        "kernels/first": "from project.kernels.second import g",
        "kernels/second": "from project.kernels import third\nimport numpy",
        "kernels/third": "import project.kernels.first",
        "kernels/alone": "import numpy",
        "before": "from project import constants",
        "constants": "",
    }
    files = {name: tmp_path / "project" / f"{name}.py" for name in sources}
    files["kernels/first"].parent.mkdir(parents=True)
    for name, source in sources.items():
        files[name].write_text(source)

    def changed() -> set[str]:
        code_cache._contents.cache_clear()
        code_cache._imports.cache_clear()
        found = set()
        for name, path in files.items():
            stamp = code_cache.source_stamp(SimpleNamespace(_py_file=str(path)))
            if known.get(name) != stamp:
                found.add(name)
            known[name] = stamp
        return found

    known: dict[str, Any] = {}
    assert changed() == set(files)
    assert changed() == set()
    files["kernels/alone"].write_text("import scipy")
    files["constants"].write_text("# changed")
    assert changed() == {"kernels/alone", "constants"}
    files["kernels/third"].write_text(sources["kernels/third"] + "\n# changed")
    assert changed() == {"kernels/first", "kernels/second", "kernels/third"}


def test_kernels_are_kept_by_this_stamp_and_under_the_lock() -> None:
    assert IndexDataCacheFile.save is code_cache.save
    stamp = code_cache.source_stamp(walk._cache._impl.locator)
    assert walk._cache._cache_file._source_stamp == stamp
    assert stamp != code_cache._stamp_of_file(walk._cache._impl.locator)
