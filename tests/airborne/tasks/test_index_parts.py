"""A large file is indexed by parts: the same is known, kept and delivered as in one go."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from spl_batch import api
from spl_batch.airborne.tasks import index
from spl_batch.airborne.tasks.file_tally import facts_of, merge, observe, spans_of
from spl_batch.engine.watch.events import Event, PhaseStarted, TaskEnded
from spl_batch.errors import InputError
from spl_batch.formats.las.reader import iter_points
from tests import surveys

POINTS = 700
"""Points of a part: five parts for each of the small survey's files, the last one shorter."""


@pytest.fixture(autouse=True)
def parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Parts of two chunks."""
    monkeypatch.setattr(index, "CHUNK_POINTS", POINTS // 2)
    monkeypatch.setattr(index, "PART_CHUNKS", 2)


def events(workflow: Path, *overrides: str, **options: Any) -> tuple[api.RunResult, list[Event]]:
    told: list[Event] = []
    result = surveys.run(workflow, *overrides, listener=told.append, **options)
    return result, told


def done(told: list[Event], kind: str) -> list[str]:
    return sorted(e.name for e in told if isinstance(e, TaskEnded) and e.kind == kind)


def facts(output: Path) -> dict[str, Mapping[str, Any]]:
    """What is known of each file, but for its parts."""
    found = (output / "store/receipts/index_file").rglob("*.json")
    read = {p.stem: json.loads(p.read_text())["facts"] for p in found}
    left_out = {"parts"}
    return {name: {k: v for k, v in f.items() if k not in left_out} for name, f in read.items()}


def in_one_go(survey: Path) -> Path:
    """Output of a run on a copy of a survey, each file read from end to end."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(index, "PART_CHUNKS", 1 << 20)
        copied = surveys.copy_of(survey, survey.parent / "whole")
        return surveys.run(copied, until="deliver").output


def test_parts_are_the_whole_file(small: Path, small_output: Path) -> None:
    result, told = events(small)
    assert surveys.results(result.output) == surveys.results(small_output)
    assert facts(result.output) == facts(small_output)
    sources = done(told, "index_file")
    sizes = [surveys.cloud(p)["X"].size for p in sorted((small.parent / "lines").glob("*.laz"))]
    wanted = sum(-(-size // POINTS) for size in sizes)
    assert len(done(told, "index_part")) == wanted > 2 * len(sources)
    (started,) = [e for e in told if isinstance(e, PhaseStarted) and e.kind == "index_part"]
    assert started.points == sum(sizes)
    assert result.report.counts.points_in == result.report.counts.points_out == sum(sizes)
    _, again = events(small)
    assert not done(again, "index_part") + done(again, "index_file") + done(again, "observe")


def test_files_that_are_not_in_time_order(small: Path) -> None:
    """Each part holds points of every stretch."""
    for path in sorted((small.parent / "lines").glob("*.laz")):
        columns = surveys.flightline(psid=int(path.stem[-1]) if path.stem[-1].isdigit() else 1)
        order = np.random.default_rng(5).permutation(len(columns["x"]))
        surveys.write_cloud(path, surveys.take(columns, order))
    result, _ = events(small, until="deliver")
    assert surveys.results(result.output) == surveys.results(in_one_go(small))


def damage(path: Path) -> bytes:
    """Change bytes in the middle of a file's points; what it held."""
    content = path.read_bytes()
    half = len(content) // 2
    path.write_bytes(content[:half] + bytes(2000) + content[half + 2000 :])
    return content


def test_a_part_that_cannot_be_read_fails_its_file_once(small: Path, small_output: Path) -> None:
    path = min((small.parent / "lines").glob("*.laz"))
    content = damage(path)
    result, told = events(small)
    assert result.exit_status == 1
    (failure,) = result.report.failures
    assert failure.place.endswith(path.name)
    assert "cannot be decoded" in failure.reason
    assert failure.task.startswith("index_file ")
    assert failure.inputs == (f"lines/{path.name}",), "and no keys of parts"
    counts = result.report.counts
    assert counts.points_in == counts.points_out > 0
    assert counts.not_read > 0
    assert all(not e.reason for e in told if isinstance(e, TaskEnded) and e.kind == "index_part")
    path.write_bytes(content)
    assert surveys.results(surveys.run(small).output) == surveys.results(small_output)


def test_a_part_that_is_lost_leaves_its_file_out_and_is_tried_again_alone(
    small: Path, small_output: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = min((small.parent / "lines").glob("*.laz"))
    read = index.iter_points

    def failing(file: Path, *, start: int, **options: Any) -> Any:
        if file == path and start == POINTS:
            raise MemoryError("no room")
        return read(file, start=start, **options)

    with monkeypatch.context() as patch:
        patch.setattr(index, "iter_points", failing)
        result, told = events(small)
    assert result.exit_status == 1
    (failure,) = result.report.failures
    assert failure.task.startswith("index_part ")
    assert failure.place == str(path)
    assert failure.inputs == (f"lines/{path.name}",)
    counts = result.report.counts
    assert counts.points_in == counts.points_out > 0
    assert counts.not_read == len(surveys.cloud(path)["X"])
    assert len(done(told, "index_file")) == 1
    again, told = events(small)
    assert done(told, "index_part") == [failure.task.split()[1]]
    assert surveys.results(again.output) == surveys.results(small_output)


def test_a_file_that_changes_after_a_part_was_read_is_not_mixed(
    small: Path, small_output: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = min((small.parent / "lines").glob("*.laz"))
    before, read = path.read_bytes(), index.iter_points
    line = surveys.flightline(shots=200, psid=1, seed=77)
    as_many = surveys.take(line, slice(0, len(surveys.cloud(path)["X"])))

    def reading(file: Path, *, start: int, **options: Any) -> Any:
        if file == path and start == POINTS and path.read_bytes() == before:
            surveys.write_cloud(path, as_many)
        return read(file, start=start, **options)

    monkeypatch.setattr(index, "iter_points", reading)
    result = surveys.run(small, until="deliver")
    assert result.exit_status == 1
    (failure,) = api.status(result.output).failures
    assert f"{path}: has changed since the run began" in failure.reason
    assert not (result.output / "laz" / "lines" / path.name).exists()
    monkeypatch.setattr(index, "iter_points", read)
    path.write_bytes(before)
    again = surveys.run(small, until="deliver")
    assert again.exit_status == 0
    assert surveys.results(again.output) == surveys.results(small_output)


def test_tallies_of_parts_add_up(tmp_path: Path) -> None:
    lines = (surveys.flightline(psid=p, start_s=surveys.START_S + 40 * p) for p in (1, 2))
    cloud = surveys.join(*lines)
    order = np.random.default_rng(3).permutation(len(cloud["x"]))
    path = surveys.write_cloud(tmp_path / "a.laz", surveys.take(cloud, order))
    tables = list(iter_points(path, channel_dimension="channel", source=1, chunk=333))
    counted = [observe(table, 1.0) for table in tables]
    whole = merge(counted)
    joined = merge(merge(some) for some in (counted[:2], counted[2:3], counted[3:], []))
    facts = facts_of(whole, 1.0)
    assert facts_of(joined, 1.0) == facts
    assert sum(array.nbytes for array in whole.values()) < 100_000, "one for each part"
    assert facts["points"] == len(cloud["x"])
    assert len(facts["spans"]) == 2
    assert spans_of(joined) == spans_of(whole)
    assert joined.keys() == whole.keys()
    assert all(np.array_equal(joined[name], values) for name, values in whole.items())


def test_a_part_that_could_not_be_read_once_is_read_by_the_next_run(
    small: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = min((small.parent / "lines").glob("*.laz"))
    read = index.iter_points

    def failing(file: Path, *, start: int, **options: Any) -> Any:
        if file == path and start == POINTS:
            raise InputError(str(path), "the disk is away")
        return read(file, start=start, **options)

    monkeypatch.setattr(index, "iter_points", failing)
    result, _ = events(small, until="index")
    assert result.exit_status == 1
    monkeypatch.setattr(index, "iter_points", read)
    again, told = events(small, until="index")
    assert again.exit_status == 0
    (part,) = done(told, "index_part")
    assert part.endswith("/1"), "the others are finished"
