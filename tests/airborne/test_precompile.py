"""Compiling ahead: what is listed is what the chain calls, and each worker gets its share."""

import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from itertools import chain
from pathlib import Path

import pytest

from benchmarks.airborne.signatures import written
from spl_batch.airborne import precompile
from spl_batch.engine.flow.cluster import SETTINGS
from spl_batch.engine.flow.warm_up import WarmUp
from spl_batch.engine.watch.events import Compiling, Note
from spl_batch.errors import StoppedError
from tests import surveys

Tell = Callable[[int, int], None]
ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_the_list_is_what_a_run_calls(tiny_survey: Path, tmp_path: Path) -> None:
    flown = surveys.copy_of(tiny_survey, tmp_path)
    ended = subprocess.run(  # noqa: S603
        [sys.executable, "-m", "benchmarks.airborne.signatures", "--check", "--flown", str(flown)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 0, (
        f"python -m benchmarks.airborne.signatures\n{ended.stdout}{ended.stderr}"
    )


def test_types_are_read_as_they_are_written() -> None:
    for name, listed in precompile.signatures().items():
        kernel = precompile.find(name)
        for stored in listed:
            assert [written(one) for one in precompile.parse(stored, kernel)] == stored
    kinds = {one[0] for listed in precompile.signatures().values() for one in chain(*listed)}
    assert kinds > {"array", "readonly", "tuple", "Rules"}


@pytest.mark.parametrize("shares", [1, 2, 3, 16, 100])
def test_shares_are_all_kernels_once_and_about_equal(shares: int) -> None:
    names = precompile.signatures()
    found = precompile.divided(names, shares)
    assert len(found) == shares
    assert sorted(name for share in found for name in share) == sorted(names)
    if 1 < shares < 4:
        sizes = [
            len({c for n in share for c in precompile._called(precompile.find(n))})
            for share in found
        ]
        assert max(sizes) < 1.2 * min(sizes)
        every = {c for name in names for c in precompile._called(precompile.find(name))}
        assert sum(sizes) < 1.1 * len(every), "what calls the same is compiled together"


def test_a_share_that_another_process_compiles_is_loaded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(precompile, "is_kept", lambda *_: False)
    told: list[tuple[int, int]] = []
    precompile.compile_share(15, 16, lambda done, of: told.append((done, of)))
    names = precompile.divided(precompile.signatures(), 16)[15]
    whole = len({called for name in names for called in precompile._called(precompile.find(name))})
    assert told == sorted(told), "what is done grows"
    assert (told[0], told[-1]) == ((0, whole), (whole, whole))
    assert len(told) == len(names) + 1
    assert all(
        precompile.find(n).signatures for n in precompile.divided(precompile.signatures(), 16)[15]
    )
    ended = subprocess.run(
        [
            sys.executable,
            "-c",
            "from spl_batch.airborne import precompile; print(precompile.compile_share(15, 16))",
        ],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    assert ended.stdout.split() == ["0"]
    monkeypatch.undo()
    told.clear()
    assert precompile.compile_share(15, 16, lambda done, of: told.append((done, of))) == 0
    assert not told, "kernels that are ready are loaded, and nobody is told of compiling"
    monkeypatch.setattr(precompile, "is_kept", lambda *_: False)
    monkeypatch.setattr(sys, "executable", shutil.which("false"))
    with pytest.raises(StoppedError, match="exit status 1"):
        precompile.compile_share(15, 16)


class Told:
    """An observer that keeps what it is told."""

    def __init__(self) -> None:
        self.notes: list[str] = []
        self.counts: list[tuple[int, int]] = []

    def tell(self, event: object) -> None:
        if isinstance(event, Note):
            self.notes.append(event.text)
        if isinstance(event, Compiling):
            self.counts.append((event.done, event.of))


def left_behind(share: int, shares: int, _tell: Tell) -> int:
    """Share number one fails, the others leave a file."""
    if share == 1:
        raise ValueError(f"share {share} of {shares}")
    return share


def all_of_it(share: int, shares: int, _tell: Tell) -> int:
    """Fails to tell that it was called."""
    raise ValueError(f"{shares} share" if share == 0 else "another")


def some_left(share: int, shares: int, tell: Tell) -> int:
    """The last share has something to do; each has two steps."""
    time.sleep(0.2 * share)
    tell(2, 2)
    time.sleep(0.2 + 0.2 * (share + 1 == shares))
    return int(share + 1 == shares)


def none_left(share: int, shares: int, _tell: Tell) -> int:
    """Everything is found done."""
    return 0 * share * shares


def test_the_other_process_finds_the_same_files_wherever_it_is_called(tmp_path: Path) -> None:
    """In a clone beside an installed version, say: its own files would be compiled."""
    other = tmp_path / "spl_batch"
    other.mkdir()
    (other / "__init__.py").write_text("raise SystemExit('not these')", encoding="utf-8")
    done = subprocess.run(  # noqa: S603 - this project's own module
        precompile._command(15, 16), cwd=tmp_path, capture_output=True, text=True, check=False,
        input="",
    )  # fmt: skip
    assert "not these" not in done.stderr


def test_each_worker_does_its_share_once_and_a_fault_is_told() -> None:
    import dask  # noqa: PLC0415 - slow
    from distributed import Client, LocalCluster  # noqa: PLC0415

    told, alone = Told(), WarmUp(all_of_it, "alone")
    with (
        dask.config.set(SETTINGS),
        LocalCluster(
            n_workers=2, processes=False, threads_per_worker=1, dashboard_address="127.0.0.1:0"
        ) as two,
        Client(two) as client,
    ):
        client.wait_for_workers(2)
        addresses = sorted(client.sync(client.scheduler.identity)["workers"])
        alone.share_out(client, addresses[:1], told)  # type: ignore[arg-type]
        again = WarmUp(left_behind, "compiling")
        again.share_out(client, addresses, told)  # type: ignore[arg-type]
        again.share_out(client, addresses, told)  # type: ignore[arg-type]
        compiled, loaded = WarmUp(some_left, "compiling"), WarmUp(none_left, "loading")
        compiled.share_out(client, addresses, told)  # type: ignore[arg-type]
        loaded.share_out(client, addresses, told)  # type: ignore[arg-type]
    assert told.notes == ["alone: 1 share", "compiling: share 1 of 2", "compiling"], (
        "what loads says nothing"
    )
    assert compiled.took_s is not None
    assert compiled.took_s >= 0.2
    assert told.counts[-1] == (4, 4), "steps of both shares, added up"
    assert {of for _, of in told.counts} == {4}, "the whole does not grow as shares begin"
    assert loaded.took_s is None
