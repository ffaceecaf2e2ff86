"""Compiled code that is kept: by several processes at once, and as long as it is current."""

import importlib
import pickle
import pkgutil
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numba import njit
from numba.core import types
from numba.core.caching import IndexDataCacheFile
from numba.core.dispatcher import Dispatcher
from numba.core.registry import cpu_target

import spl_batch
from spl_batch.airborne.filter.ellipsoid.spacing import walk
from spl_batch.imports import content_hash, imported
from spl_batch.numerics import compiled
from spl_batch.numerics.compiled import KeptCode, source_stamp
from spl_batch.numerics.linked_code import CompilerForLinking, LinkedLibrary

WRITERS = 4


@compiled.njit()
def doubled(number):  # type: ignore[no-untyped-def]
    return 2 * number


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


def kept(folder: Path) -> KeptCode:
    """What another process sees of a function's code."""
    return KeptCode(str(folder), "module.function", "stamp")


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
    earlier = KeptCode(str(tmp_path), "module.function", "earlier stamp")
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


def kernels() -> Iterator[Any]:
    """Every compiled function of the project."""
    for module in pkgutil.walk_packages(spl_batch.__path__, "spl_batch."):
        if not module.name.endswith("__main__"):
            found = vars(importlib.import_module(module.name)).values()
            yield from (value for value in found if isinstance(value, Dispatcher))


def test_every_kernel_is_kept_so() -> None:
    """Also those outside the airborne survey's: the receivers' own and what sorts rows."""
    found = [*kernels()]
    homes = {kernel.py_func.__module__.rpartition(".")[0] for kernel in found}
    assert "spl_batch.geiger.coincidence.surface" in homes
    for kernel in found:
        files = kernel._cache._cache_file
        assert type(files) is KeptCode, kernel
        assert files._source_stamp == source_stamp(Path(kernel.py_func.__code__.co_filename))
        assert kernel.targetoptions["nogil"] is True
        apart = kernel.for_kernels._cache._cache_file
        assert type(apart) is KeptCode, kernel
        assert apart._source_stamp == files._source_stamp
        assert apart._index_path != files._index_path, "code without wrappers lies apart"


def test_the_stamp_follows_what_is_called() -> None:
    files = imported(Path(walk.py_func.__code__.co_filename))
    assert {"spacing.py", "kdtree.py", "compiled.py"} <= {file.name for file in files}
    assert source_stamp(Path(walk.py_func.__code__.co_filename)) == content_hash(files)


def test_a_kernel_that_is_called_with_a_constant_is_that_for_any_number() -> None:
    for given in (types.literal(1), types.literal(7), types.int64):
        doubled.get_call_template((given,), {})
    assert doubled.for_kernels.nopython_signatures == [types.int64(types.int64)]


@compiled.njit()
def tripled(number):  # type: ignore[no-untyped-def]
    return 3 * number


@compiled.njit()
def tripled_twice(number):  # type: ignore[no-untyped-def]
    return tripled(tripled(number))


def test_what_only_kernels_call_has_no_wrapper_for_python() -> None:
    assert tripled_twice(2) == 18
    assert (len(tripled_twice.signatures), len(tripled_twice.for_kernels.signatures)) == (1, 0)
    tripled.get_call_template((types.int64,), {})  # as that did, unless its code was kept
    assert (len(tripled.signatures), len(tripled.for_kernels.signatures)) == (0, 1)
    assert tripled(2) == 6, "Python may call it all the same"
    assert tripled_twice.py_func(2) == 18


@compiled.njit()
def checked_rows(rows):  # type: ignore[no-untyped-def]
    taken = np.zeros(rows, np.float64)
    if rows > 2:
        raise ValueError("too many rows")
    return taken


@compiled.njit()
def sum_of_rows(rows):  # type: ignore[no-untyped-def]
    return checked_rows(rows).sum() + tripled(rows)


def test_linked_code_is_taken_in_and_never_made_ready_to_run() -> None:
    """What a called kernel makes and raises reaches Python."""
    assert sum_of_rows(2) == 6.0
    with pytest.raises(ValueError, match="too many rows"):
        sum_of_rows(3)
    compile_: Any = njit
    fresh = compile_(pipeline_class=CompilerForLinking, no_cpython_wrapper=True)(
        checked_rows.py_func
    )
    fresh.get_call_template((types.int64,), {})
    library = fresh.overloads[(types.int64,)].library
    assert isinstance(library, LinkedLibrary)
    kind = library.serialize_using_object_code()[1]
    assert kind == "bitcode"


@compiled.njit()
def short_rows(rows):  # type: ignore[no-untyped-def]
    return np.zeros(rows, np.int16)


@compiled.njit()
def twice_as_short(rows):  # type: ignore[no-untyped-def]
    return short_rows(rows).sum() + np.zeros(rows, np.int16).sum()


def test_what_numba_has_for_kernels_is_linked_and_one_for_all() -> None:
    for kernel in (short_rows.for_kernels, twice_as_short):
        kernel._cache.disable()
    assert twice_as_short(3) == 0
    zeros = cpu_target.typing_context.resolve_value_type(np.zeros)
    made = [
        made
        for template in zeros.templates
        for (_, args, *_), (dispatcher, _) in template._impl_cache.items()
        if args[1:] == (types.NumberClass(types.int16),)
        for made in dispatcher.overloads.values()
    ]
    assert [type(one.library) for one in made] == [LinkedLibrary]


def test_linked_code_is_loaded_as_it_was_kept() -> None:
    sum_of_rows(2)
    again = compiled.njit()(checked_rows.py_func)
    again.get_call_template((types.int64,), {})
    assert sum(again.for_kernels.stats.cache_hits.values()) == 1
    assert type(again.for_kernels.overloads[(types.int64,)].library) is LinkedLibrary


@compiled.njit(inline="always")
def halved(number):  # type: ignore[no-untyped-def]
    return number / 2


@compiled.njit()
def quartered(number):  # type: ignore[no-untyped-def]
    return halved(halved(number))


def test_what_is_always_inlined_is_compiled_once_and_inlined_by_llvm() -> None:
    halved.for_kernels._cache.disable()
    quartered._cache.disable()
    assert quartered(3.0) == 0.75
    (made,) = halved.for_kernels.overloads.values()
    assert made.fndesc.inline
    assert halved(3.0) == 1.5, "Python may call it all the same"


def test_an_index_whose_types_are_gone_names_no_code(tmp_path: Path) -> None:
    earlier = kept(tmp_path)
    earlier.save("types", "code")
    path = Path(earlier._index_path)
    version, rest = pickle.dumps(earlier._version), b"cspl_batch.no_such_module\nGone\n."
    path.write_bytes(version + rest)
    assert kept(tmp_path)._load_index() == {}
    kept(tmp_path).save("types", "code")
    assert kept(tmp_path).load("types") == "code"
