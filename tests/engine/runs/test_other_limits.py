"""A run goes on with more or less memory than earlier ones had."""

from pathlib import Path
from typing import Any

import pytest

from spl_batch import api
from spl_batch.airborne.filter import denoise
from spl_batch.airborne.plan import survey_ledger, task_memory
from spl_batch.airborne.plan.block_size import remembered_sizes, remembered_stretch
from spl_batch.airborne.settings.workflow import load_workflow
from spl_batch.airborne.tasks import space_domain, time_domain
from spl_batch.engine.store.working_store import Store
from spl_batch.engine.watch.events import Event, Note, TaskEnded
from spl_batch.errors import WorkflowError
from tests import surveys

SMALL, LARGE = "1536MiB", "8GiB"


@pytest.fixture
def passes(tmp_path: Path) -> Path:
    """Workflow of four short passes, 60 m apart, on tiles of 50 m."""
    x, y = surveys.ORIGIN_M
    for k in range(4):
        there, then = (x + 60 * k, y), surveys.START_S + 3 * k
        line = surveys.flightline(shots=120, psid=k + 1, start_s=then, seed=k, origin_m=there)
        surveys.write_cloud(tmp_path / "lines" / f"line_{k + 1}.laz", line)
    return surveys.write_workflow(tmp_path, tiling={"tile_m": 50.0})


@pytest.fixture
def _long_stretches(monkeypatch: pytest.MonkeyPatch) -> None:
    """A pass of 3000 points is one stretch with 8 GiB, and several with less."""
    monkeypatch.setattr(survey_ledger, "stretch_points", lambda limit: limit // 2**21)


@pytest.fixture
def _large_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """The four passes are one block with 8 GiB, and several with less."""
    heavy = {**task_memory.BYTES_PER_POINT, "denoise": 88_000, "denoise_air": 88_000}
    monkeypatch.setattr(task_memory, "BYTES_PER_POINT", heavy)


def go_on(workflow: Path, limit: str, *overrides: str, **options: Any) -> tuple[int, list[str]]:
    """Run with a memory limit; how many tasks were done, and what is said of the limit."""
    told: list[Event] = []
    ended = surveys.run(workflow, *overrides, memory=limit, listener=told.append, **options)
    assert ended.exit_status == 0
    done = sum(isinstance(event, TaskEnded) for event in told)
    return done, [e.text for e in told if isinstance(e, Note) and "--memory" in e.text]


def left(workflow: Path, limit: str) -> str:
    """Stage at which a run with a memory limit would go on; empty where all is finished."""
    found = api.plan(workflow, workers=0, memory=limit).left
    assert found is not None
    return found.stage


def warning(workflow: Path, limit: str) -> str:
    """What a plan says of a memory limit."""
    said = api.plan(workflow, workers=0, memory=limit).findings
    return " ".join(one.text for one in surveys.found(said, "E01", "memory"))


@pytest.mark.usefixtures("_long_stretches")
def test_stretches_stay_as_they_are_with_more_memory(passes: Path) -> None:
    assert go_on(passes, SMALL, until="shots")[0] > 30
    assert go_on(passes, LARGE, until="shots") == (0, [])
    done, _ = go_on(passes, LARGE, until="shots", fresh=True)
    assert 0 < done < 30, "emptied, they are as long as they can be"


def test_short_flightlines_and_their_blocks_are_the_same_with_less_memory(passes: Path) -> None:
    assert survey_ledger.stretch_points(2**30 * 3 // 2) < survey_ledger.stretch_points(2**33)
    go_on(passes, LARGE)
    remembered = passes.parent / "out/store/blocks.json"
    before = remembered.read_bytes()
    assert warning(passes, SMALL) == ""
    assert go_on(passes, SMALL) == (0, [])
    assert remembered.read_bytes() == before, "nothing was cut: what comes may be as long as before"


@pytest.mark.usefixtures("_long_stretches")
def test_a_look_with_less_memory_leaves_stretches_as_they_are(passes: Path) -> None:
    go_on(passes, LARGE)
    assert not left(passes, LARGE)
    assert left(passes, SMALL) == "shots"
    told = "4 of 4 flightlines are cut into shorter stretches than in earlier runs"
    assert told in warning(passes, SMALL)
    assert "--memory 8192MiB they are used as they are" in warning(passes, SMALL), "blocks too"
    done, said = go_on(passes, SMALL, until="index")
    assert done == 0
    assert [told in text for text in said] == [True]
    assert not left(passes, LARGE)
    assert warning(passes, LARGE) == ""


@pytest.mark.usefixtures("_long_stretches")
def test_filters_are_compared_on_the_stretches_that_there_are(passes: Path) -> None:
    go_on(passes, SMALL, until="shuffle")
    told: list[Event] = []
    api.compare(passes, "vsaes,none", workers=0, memory=LARGE, listener=told.append)
    done = {event.kind for event in told if isinstance(event, TaskEnded)}
    assert "denoise" in done
    assert "gather" not in done


@pytest.mark.usefixtures("_long_stretches", "_large_blocks")
def test_blocks_that_would_be_done_again_anyway_are_not_told_of(passes: Path) -> None:
    go_on(passes, LARGE)
    go_on(passes, SMALL, until="shuffle")
    assert left(passes, LARGE) == "denoise"
    assert warning(passes, SMALL) == ""


@pytest.mark.usefixtures("_large_blocks")
def test_what_is_cut_anew_is_told_once_where_a_file_is_mended(passes: Path) -> None:
    go_on(passes, LARGE)
    tile = min((passes.parent / "out/store/tiles").iterdir())
    tile.write_bytes(tile.read_bytes()[:-99] + bytes(99))
    done, said = go_on(passes, SMALL)
    assert done > 4
    assert len(said) == 1


@pytest.mark.usefixtures("_long_stretches")
def test_stretches_of_less_memory_are_kept_once_they_are_gathered(passes: Path) -> None:
    go_on(passes, LARGE, until="shots")
    done, _ = go_on(passes, SMALL, until="shots")
    assert done > 20
    assert go_on(passes, LARGE, until="shots") == (0, [])


@pytest.mark.usefixtures("_long_stretches")
def test_stretches_of_less_memory_that_all_fail_are_not_kept(
    passes: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    short = surveys.flightline(shots=20, psid=9, start_s=surveys.START_S + 30, seed=9)
    surveys.write_cloud(passes.parent / "lines/short.laz", short)
    go_on(passes, LARGE, until="shots")
    store = Store(passes.parent / "out")
    known = remembered_stretch(store)
    assert known is not None

    def killed(*_: object) -> None:
        raise MemoryError

    with monkeypatch.context() as broken:
        broken.setattr(time_domain, "gather", killed)
        assert surveys.run(passes, memory=SMALL, until="shots").exit_status == 1
    assert remembered_stretch(store) == known


@pytest.mark.usefixtures("_large_blocks")
def test_a_look_with_less_memory_leaves_blocks_as_they_are(passes: Path) -> None:
    go_on(passes, LARGE)
    assert left(passes, SMALL) == "denoise"
    assert "1 of 1 finished blocks are cut smaller" in warning(passes, SMALL)
    assert "--memory 8192MiB they are used as they are" in warning(passes, SMALL)
    done, said = go_on(passes, SMALL, until="shuffle")
    assert done == 0
    assert ["blocks are cut smaller" in text for text in said] == [True]
    assert not left(passes, LARGE)
    assert warning(passes, LARGE) == ""


@pytest.mark.usefixtures("_large_blocks")
def test_a_block_of_less_memory_done_alone_leaves_the_others_as_they_are(passes: Path) -> None:
    go_on(passes, LARGE)
    with pytest.raises(WorkflowError, match="no such task; there are") as none:
        api.run_alone(passes, "denoise none", workers=0, memory=SMALL)
    block = str(none.value).split("there are ")[1].split(",")[0]
    assert api.run_alone(passes, f"denoise {block}", workers=0, memory=SMALL).exit_status == 0
    assert not left(passes, LARGE)


@pytest.mark.usefixtures("_large_blocks")
def test_blocks_of_less_memory_are_kept_once_they_are_done(passes: Path) -> None:
    go_on(passes, LARGE)
    before = surveys.labels(passes.parent / "out")
    done, said = go_on(passes, SMALL)
    assert done > 4
    assert said
    report = (passes.parent / "out/report.json").read_text()
    assert "--memory" not in report, "it is for those who do not run it"
    assert go_on(passes, LARGE) == (0, [])
    surveys.assert_same_labels(before, surveys.labels(passes.parent / "out"))


@pytest.mark.usefixtures("_large_blocks")
def test_blocks_of_less_memory_that_all_fail_are_not_kept(
    passes: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    smaller = "1536MiB"
    x, y = surveys.ORIGIN_M
    away = surveys.flightline(shots=20, psid=9, seed=9, origin_m=(x + 5000, y))
    surveys.write_cloud(passes.parent / "lines/away.laz", away)
    go_on(passes, LARGE, until="denoise")
    assert "2 of 3 finished blocks are cut smaller" in warning(passes, smaller)

    def killed(*_: object) -> None:
        raise MemoryError

    with monkeypatch.context() as broken:
        broken.setattr(space_domain, "denoise", killed)
        assert surveys.run(passes, memory=smaller, until="denoise").exit_status == 1
    assert left(passes, LARGE) == "ground"


def test_sizes_that_are_given_are_not_remembered(passes: Path) -> None:
    go_on(passes, LARGE)
    store = Store(passes.parent / "out")
    known = remembered_sizes(store, load_workflow(passes))
    assert known is not None
    assert go_on(passes, SMALL, "tiling.block_tiles=1", until="denoise")[0] > 1
    assert remembered_sizes(store, load_workflow(passes)) == known
    assert not left(passes, LARGE)


@pytest.mark.usefixtures("_large_blocks")
def test_a_choice_that_has_led_to_nothing_does_not_bind(
    passes: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def none(*_: object) -> None:
        raise MemoryError

    with monkeypatch.context() as patch:
        patch.setattr(denoise, "judge", none)
        assert surveys.run(passes, memory=SMALL).exit_status == 1
    store = Store(passes.parent / "out")
    chosen = remembered_sizes(store, load_workflow(passes))
    assert chosen is not None
    go_on(passes, LARGE, until="denoise")
    now = remembered_sizes(store, load_workflow(passes))
    assert now is not None
    assert (chosen.memory_bytes, now.memory_bytes) == (3 * 2**29, 2**33)
    unfiltered = ("filter.method=none", "afterpulse.enabled=false")
    go_on(passes, SMALL, *unfiltered, until="shuffle", fresh=True)
    assert remembered_stretch(store) is None
