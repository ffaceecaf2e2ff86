"""Compiling ahead: what is listed is what the chain calls, and each worker gets its share."""

import json
import subprocess
import sys
from functools import partial
from itertools import chain
from pathlib import Path

import pytest

from benchmarks.airborne.signatures import written
from spl_batch.airborne import precompile
from spl_batch.airborne.settings.workflow import parse_workflow
from spl_batch.engine.flow.warm_up import WarmUp
from spl_batch.engine.watch.events import Compiling, Event, Note
from tests import surveys

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
    kinds = set()
    for kernels in precompile.signatures().values():
        for name, listed in kernels.items():
            kernel = precompile.find(name)
            for stored in listed:
                assert [written(one) for one in precompile.parse(stored, kernel)] == stored
                kinds |= {one[0] for one in stored}
    assert kinds > {"array", "readonly", "tuple", "Rules"}


def test_only_what_a_workflow_calls_is_compiled() -> None:
    workflow = parse_workflow(
        {"survey": {"flightlines": "a"}, "output": "o", "products": {"intensity": "las"}}, "w"
    )
    every, fewer = precompile.listed(), precompile.listed(workflow)
    left_out = {name for step in every for name in {*every[step]} - {*fewer[step]}}
    assert left_out == {n for names in every.values() for n in names if "reflectance" in n} != set()
    assert [*precompile.listed(until="denoise")] == ["observe", "scatter", "denoise"]


@pytest.mark.parametrize("shares", [1, 2, 3, 16, 100])
def test_shares_are_all_kernels_once_and_about_equal(shares: int) -> None:
    names = precompile.listed()
    found = precompile.divided(names, shares)
    assert len(found) == shares
    for step, of_step in names.items():
        assert sorted(name for share in found for name in share[step]) == sorted(of_step)
    if 1 < shares < 4:
        sizes = [
            len({c for n in chain(*share.values()) for c in precompile._called(precompile.find(n))})
            for share in found
        ]
        assert max(sizes) < 1.2 * min(sizes)
        every = {c for n in chain(*names.values()) for c in precompile._called(precompile.find(n))}
        assert sum(sizes) < 1.1 * len(every), "what calls the same is compiled together"


def test_what_a_process_compiles_is_there_for_others(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    told: list[Event] = []
    names = {"observe": ["spl_batch.airborne.beams.shot_runs:lag_behind"], "denoise": []}
    command, steps = partial(precompile._command, json.dumps(names)), [*names]
    for made, at in ((1, 2), (0, 2)):
        one = WarmUp(command, steps, "compiling", tmp_path / f"{made}.compiled", 1)
        one.begin(told.append)
        one.wait_for("denoise")
        one.finish()
        assert one.made == made
        assert one.mark.exists()
        assert len(told) == at, "who finds all compiled reports nothing"
    assert told == [Note("info", "compiling"), Compiling(1, 1)]


def test_the_other_process_finds_the_same_files_wherever_it_is_called(tmp_path: Path) -> None:
    """In a clone beside an installed version, say: its own files would be compiled."""
    other = tmp_path / "spl_batch"
    other.mkdir()
    (other / "__init__.py").write_text("raise SystemExit('not these')", encoding="utf-8")
    with subprocess.Popen(  # noqa: S603 - this project's own module
        precompile._command('{"denoise": []}', 15, 16),
        cwd=tmp_path, text=True,
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    ) as child:  # fmt: skip
        assert child.stdout is not None
        assert child.stdout.read() == "0 0 0 1\n"


def test_a_process_that_compiles_ends_with_the_one_that_started_it() -> None:
    everything = json.dumps(precompile.listed())
    with subprocess.Popen(  # noqa: S603
        precompile._command(everything, 0, 1), stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as child:
        assert child.stdout is not None
        child.stdout.readline()
        child.communicate()
    assert child.returncode == 1


def test_code_of_another_version_has_another_mark(monkeypatch: pytest.MonkeyPatch) -> None:
    mine = precompile._compiling.__wrapped__('["index"]').mark
    assert mine == precompile._compiling.__wrapped__('["index"]').mark
    monkeypatch.setattr(precompile, "code_version", lambda _: "another")
    other = precompile._compiling.__wrapped__('["index"]').mark
    assert other.name.partition("-")[0] != mine.name.partition("-")[0]
    assert other.name.partition("-")[2] == mine.name.partition("-")[2]
