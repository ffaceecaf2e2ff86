"""What a report says of the time that earlier runs took."""

import json
from collections.abc import Sequence
from pathlib import Path

from spl_batch.engine.watch.earlier_runs import earlier_wall_s, log_bytes, share_time

from spl_batch.engine.store.working_store import write_json
from spl_batch.engine.watch.events import (
    Event,
    PhaseStarted,
    RunEnded,
    RunStarted,
    TaskEnded,
    as_record,
)
from tests import surveys

WORK = "TaskEnded"
IDLE = "PhaseStarted"


def line(second: int, event: str, stage: str = "", *, anew: bool = False) -> str:
    """An event of this kind as a run logs it."""
    events: dict[str, Event] = {
        "RunStarted": RunStarted("w.yaml", 2, "0.1+x", anew=anew),
        WORK: TaskEnded(stage, "k", "x", 10, 1.0, ""),
        IDLE: PhaseStarted(stage, "k", 0, 1, 0),
        "RunEnded": RunEnded(0),
    }
    moment = f"2026-01-01T00:00:{second:02d}.000+00:00"
    return json.dumps({**as_record(events[event]), "time": moment}) + "\n"


def log(output: Path, runs: Sequence[tuple[int, int, str, bool]], *, torn: str = "") -> None:
    """Runs by first and last second, what they tell, and whether they began anew."""
    with (output / "log.jsonl").open("a") as stream:
        for first, last, event, anew in runs:
            stream.write(line(first, "RunStarted", anew=anew) + line(last, event, "index"))
        stream.write(torn)


def finished(output: Path, wall_s: float, **more: float | None) -> None:
    (output / "store").mkdir(exist_ok=True)
    kept = {"wall_s": wall_s, "log_bytes": log_bytes(output), **more}
    write_json(output / "store" / "run.json", {"told": json.dumps(kept)})


def test_every_part_of_an_interrupted_run_counts(tmp_path: Path) -> None:
    assert earlier_wall_s(tmp_path) is None, "nothing tells"
    now = (50, 51, WORK, False)
    log(tmp_path, [(0, 9, WORK, True), (10, 12, IDLE, False), (20, 24, WORK, False), now])
    assert earlier_wall_s(tmp_path) == 9 + 4, "neither idle ones nor the one at work"
    finished(tmp_path, 20.0)
    log(tmp_path, [(52, 55, WORK, False), now])
    assert earlier_wall_s(tmp_path) == 20.0 + 3, "what a report has told is not counted twice"


def test_what_one_run_did_not_know_no_later_one_does(tmp_path: Path) -> None:
    finished(tmp_path, 100.0)
    assert earlier_wall_s(tmp_path) == 100.0
    finished(tmp_path, 100.0, earlier_s=None)
    assert earlier_wall_s(tmp_path) is None


def test_what_was_forgotten_does_not_count(tmp_path: Path) -> None:
    log(tmp_path, [(0, 9, WORK, True), (10, 12, WORK, False), (20, 24, WORK, True)])
    log(tmp_path, [(30, 31, WORK, False), (40, 41, WORK, False)])
    assert earlier_wall_s(tmp_path) == 4 + 1


def test_a_killed_run_lasted_to_its_last_whole_line(tmp_path: Path) -> None:
    log(tmp_path, [(0, 9, WORK, True)], torn='{"time": "2026-01-01T00:00:3\n')
    log(tmp_path, [(20, 21, WORK, False)])
    assert earlier_wall_s(tmp_path) == 9


def test_what_outputs_share_took_as_long_as_where_it_was_done(tmp_path: Path) -> None:
    done, wanted = tmp_path / "done", tmp_path / "wanted"
    for folder in (done, wanted):
        (folder / "store").mkdir(parents=True)
    share_time(done, wanted, ["index"])
    assert earlier_wall_s(wanted) is None, "nothing tells"

    def lines(*told: tuple[int, str, str]) -> str:
        return "".join(line(*one) for one in told)

    stopped = lines((0, "RunStarted", ""), (4, "TaskEnded", "index"), (7, "TaskEnded", "shots"))
    torn = '{"time": "2026-01-01T00:00:09.000+00:00", "event": "TaskEnded", "stage": "sho\n'
    whole = lines(
        (10, "RunStarted", ""), (11, "PhaseStarted", "index"), (13, "TaskEnded", "shots"),
        (19, "TaskEnded", "shuffle"), (20, "PhaseStarted", "denoise"), (50, "TaskEnded", "denoise"),
    )  # fmt: skip
    idle = lines((51, "RunStarted", ""), (52, "PhaseStarted", "index"), (53, "RunEnded", ""))
    (done / "log.jsonl").write_text(stopped + torn + whole + idle)
    expected = {("index",): 4, ("index", "shots"): 7 + 3, ("index", "shots", "shuffle"): 7 + 9}
    for stages, wall_s in expected.items():
        share_time(done, wanted, stages)
        assert earlier_wall_s(wanted) == wall_s, "not what came after them"
    log(wanted, [(0, 5, WORK, False), (10, 11, WORK, False)])
    assert earlier_wall_s(wanted) == 16 + 5, "its own stopped runs count as well"
    finished(wanted, 30.0)
    assert earlier_wall_s(wanted) == 30.0, "a report holds all of it"
    with (done / "log.jsonl").open("a") as stream:
        stream.write(lines((54, "RunStarted", ""), (57, "TaskEnded", "index")))
    share_time(done, wanted, ["index", "shots", "shuffle"])
    assert earlier_wall_s(wanted) == 30.0 + 3, "but for what was shared after it"
    finished(wanted, 35.0)
    share_time(done, wanted, ["index", "shots", "shuffle"])
    assert earlier_wall_s(wanted) == 35.0


def test_a_resumed_run_tells_the_time_of_all_its_parts_or_that_it_is_one(tmp_path: Path) -> None:
    surveys.write_cloud(tmp_path / "lines/1.laz", surveys.flightline(shots=60))
    workflow = surveys.write_workflow(tmp_path)
    output = surveys.run(workflow, until="deliver").output
    first = json.loads((output / "log.jsonl").read_text().splitlines()[0])
    assert first["anew"] is True
    result = surveys.run(workflow)
    assert result.report is not None
    work = result.report.performance
    assert 0 < work.earlier_wall_s < work.wall_s
    assert "of it in this one" in dict(result.screen)["run time"]
    assert "of it in earlier runs, stopped ones included" in (output / "report.html").read_text()
    for name in ("log.jsonl", "store/run.json", "store/rest.json"):
        (output / name).unlink()
    result = surveys.run(workflow)
    assert result.report is not None
    assert result.report.performance.points_per_s is None
    assert dict(result.screen)["run time"].endswith(
        "for this part alone; the rest was finished before"
    )
    assert "for this part alone" in (output / "report.html").read_text()
