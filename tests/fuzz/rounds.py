"""Rounds of mutants, each in a process of its own, which a crash of a library ends alone."""

import multiprocessing
import tempfile
import traceback
import warnings
from collections import Counter
from pathlib import Path
from typing import Any, Final

from hypothesis import HealthCheck, Phase, given, seed, settings

from spl_batch.errors import is_fault, one_line
from tests.fuzz import readers, whole_runs
from tests.fuzz.mutants import Seed, mutants
from tests.fuzz.seeds import seed as sound_file

RUN_SHARE: Final = 0.02
"""Part of all mutants that go through whole runs."""


def made_of(name: str) -> Seed:
    """Sound file of a format, or of a kind of whole run."""
    return whole_runs.kind(name).seed if name in whole_runs.KINDS else sound_file(name)


def attempt(name: str, content: bytes, folder: Path) -> bool:
    """Read a mutant, or run a survey with it; whether it could be used."""
    if name not in whole_runs.KINDS:
        return readers.attempt(name, content, folder)
    return whole_runs.attempt(name, [content], folder) == 0


def fuzz(name: str, count: int, start: int, folder: Path, tell: Any) -> None:
    """Read mutants of a format; tells of each: the content before, what came of it after."""
    warnings.simplefilter("error")
    here = Path(tempfile.mkdtemp(dir=folder))

    @settings(
        max_examples=count, deadline=None, database=None, phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )  # fmt: skip
    @seed(start)
    @given(mutants(made_of(name)))
    def each(content: bytes) -> None:
        tell.send(("begun", content))
        try:
            sound = attempt(name, content, here)
        except BaseException as error:
            if not is_fault(error):
                raise
            tell.send(("broken", f"{one_line(error)}\n{traceback.format_exc()}"))
        else:
            tell.send(("sound" if sound else "refused", ""))

    each()
    tell.send(("done", ""))


def rounds(name: str, count: int, start: int, folder: Path) -> tuple[Counter[str], list[str]]:
    """Mutants of a format in a child, begun again where it crashes; what came of them."""
    came: Counter[str] = Counter()
    said: list[str] = []
    context = multiprocessing.get_context("spawn")
    while came.total() < count:
        ours, theirs = context.Pipe(duplex=False)
        left = count - came.total()
        child = context.Process(
            target=fuzz, args=(name, left, start + came.total(), folder, theirs)
        )
        child.start()
        theirs.close()
        content, what = b"", ""
        try:
            while what != "done":
                what, value = ours.recv()
                if what == "begun":
                    content = value
                elif what != "done":
                    came[what] += 1
                    if what == "broken":
                        said.append(keep(folder, name, content, value, len(said)))
        except EOFError:
            child.join()
            came["crashed"] += 1
            text = f"the process ended with {child.exitcode}"
            said.append(keep(folder, name, content, text, len(said)))
        child.join()
        if what == "done":
            break
    return came, said


def share(name: str, count: int, names: list[str]) -> int:
    """Mutants of one of some names."""
    runs = [other for other in names if other in whole_runs.KINDS]
    if runs == names:
        return -(-count // len(names))
    if name in runs:
        return -(-int(count * RUN_SHARE) // len(runs))
    return -(-count // (len(names) - len(runs)))


def keep(folder: Path, name: str, content: bytes, text: str, number: int) -> str:
    """Keep a finding; what is said of it."""
    path = folder / f"{name.replace(' ', '_')}_{number}{made_of(name).suffix}"
    path.write_bytes(content)
    path.with_suffix(".txt").write_text(text)
    return f"{path.name}: {text.splitlines()[0]}"
