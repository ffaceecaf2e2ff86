"""A survey that is hurt every few seconds, and whether its results are those of an untouched one.

Run ``python -m benchmarks.soak [--minutes 60] [--faults N] [--seed 1] [--folder FOLDER]``. With
``--record WHAT`` the record of :mod:`benchmarks.faults`, from which the security page has its
numbers, gets a line.

Simulates three short flightlines and runs each of four states once, untouched: with and without
the third flightline, with two values of ``filter.alpha``. Then it changes the state, damages what
lies in the store and the output, and kills, stops and starves runs at random moments, in this
machine's processes and on a dask cluster of its own. After every few faults one more run goes to
its end: clouds and rasters must be those of the untouched run of that state, byte for byte. A run
that nothing ends must exit with 0, a full disk or a lost scheduler makes it 3, and no run may show
a traceback or a line of more than 300 characters.

All processes are forked from this one, which has loaded the modules and the kernels: a run costs
a second, and faults come every few seconds. Disks are filled where this user may mount a file
system in memory; else that fault is left out, which is said. Prints a table of faults tried and
survived at its end, or when it is interrupted; exits with 1 where one was not survived, and leaves
the folder of each difference beside FOLDER.
"""

import argparse
import contextlib
import json
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from benchmarks import faults
from benchmarks.soak_victims import (
    ALPHAS,
    DONE,
    STOPPED,
    Child,
    Cluster,
    HurtError,
    Survey,
    cut,
    flip,
    small_disk,
    spl_batch,
)
from spl_batch.airborne.precompile import compile_share
from spl_batch.airborne.simulate import simulate
from spl_batch.airborne.simulate.scene.scene_file import parse_scene
from spl_batch.engine.report.schema import schemas
from spl_batch.engine.tasks.runner import code_version

ENDLESS: Final = 10**9
"""More faults than any time allows [count]."""

SCENE: Final[dict[str, Any]] = {
    "extent_m": [70, 60],
    "seed": 5,
    "buildings": {"count": 1},
    "trees": {"cover": 0.2},
    "flights": [
        {"heading_deg": 0, "offset_m": 300},
        {"heading_deg": 90, "offset_m": -280},
        {"heading_deg": 180, "offset_m": 250},
    ],
    "acquisition": {"prf_hz": 4000, "gate_m": 120},
}
LINE_MAX: Final = 300


@dataclass
class Soak:
    """Faults, one after the other."""

    survey: Survey
    cluster: Cluster
    dice: random.Random
    can_fill: bool
    tried: Counter[str] = field(default_factory=Counter)
    survived: Counter[str] = field(default_factory=Counter)
    differences: list[str] = field(default_factory=list)
    tally: list[str] = field(default_factory=list)

    def faults(self) -> dict[str, tuple[int, Callable[[], None]]]:
        """What may happen, how often among all, and what does it."""
        place = self._damage
        found = {
            "setting changed, or back": (4, self.survey.swap_setting),
            "flightline removed, or added": (4, self.survey.swap_line),
            "store: byte flipped": (5, lambda: place("store", flip, "flipped")),
            "store: file cut off": (2, lambda: place("store", cut, "cut")),
            "store: file deleted": (2, lambda: place("store", Path.unlink, "deleted")),
            "output: byte flipped": (3, lambda: place("output", flip, "flipped")),
            "output: file deleted": (2, lambda: place("output", Path.unlink, "deleted")),
            "store: byte flipped during a run": (3, self._flip_in_a_run),
            "SIGKILL of the client": (6, lambda: self._signal(signal.SIGKILL)),
            "SIGTERM of the client": (2, lambda: self._signal(signal.SIGTERM)),
            "SIGSTOP of the client": (3, lambda: self._signal(signal.SIGSTOP)),
            "SIGKILL of a cluster's client": (2, lambda: self._on_cluster("client")),
            "SIGKILL of a worker": (4, lambda: self._on_cluster("worker")),
            "SIGSTOP of a worker": (2, lambda: self._on_cluster("worker", stop=True)),
            "SIGKILL of the scheduler": (2, lambda: self._on_cluster("scheduler")),
            "SIGSTOP of the scheduler": (1, lambda: self._on_cluster("scheduler", stop=True)),
        }
        if self.can_fill:
            found["disk full"] = (4, self._full_disk)
        return found

    def round(self) -> None:
        """A few faults, then a run to the end, then a look at what it gives."""
        kinds = self.faults()
        names, weights = list(kinds), [weight for weight, _ in kinds.values()]
        chosen = self.dice.choices(names, weights, k=self.dice.randrange(2, 6))
        wrong, begun = "", []
        try:
            for name in chosen:
                begun.append(name)
                kinds[name][1]()
            self._finish()
        except HurtError as error:
            wrong = str(error)
        self.tried.update(begun)
        if not wrong:
            self.survived.update(begun)
            return
        self.differences.append(f"{', '.join(begun)}: {wrong}")
        kept = self.survey.folder.parent / f"difference_{len(self.differences)}"
        shutil.copytree(self.survey.folder, kept, dirs_exist_ok=True)
        (kept / "faults.txt").write_text("\n".join([*begun, wrong, *self.tally[-20:]]))
        shutil.rmtree(self.survey.output, ignore_errors=True)
        self.survey.flipped.clear()

    # Runs

    def _finish(self) -> None:
        survey, start = self.survey, time.monotonic()
        self._judge(spl_batch(survey, "--workers", "0"), {DONE})
        survey.run_s = 0.8 * survey.run_s + 0.2 * (time.monotonic() - start)
        wanted = survey.expected[survey.alpha, survey.without]
        given = {k: v for k, v in survey.results().items() if not k.endswith(".kept")}
        # What was flipped is no longer the run's own: a flightline that goes leaves it there.
        for name in given.keys() - wanted.keys() - survey.flipped:
            raise HurtError(f"{name} should not be there")
        for name, content in wanted.items():
            if given.get(name) != content:
                raise HurtError(f"{name} is {'another' if name in given else 'missing'}")

    def _judge(self, child: Child, allowed: set[int]) -> None:
        status = child.wait()
        text = child.text()
        if status not in allowed:
            raise HurtError(f"ended with {status}: {text[-600:]}")
        if "Traceback" in text:
            raise HurtError(f"a traceback: {text[-2000:]}")
        longest = max(text.splitlines() or [""], key=len)
        if len(longest) > LINE_MAX:
            raise HurtError(f"a line of {len(longest)} characters: {longest[:400]}")

    def _something_to_do(self) -> None:
        """Take away a random part of what is finished, so that a run has work."""
        receipts = sorted((self.survey.output / "store/receipts").rglob("*.json"))
        for path in (
            receipts if self.dice.random() < 0.3 else self.dice.sample(receipts, len(receipts) // 3)
        ):
            path.unlink()

    def _moment(self, child: Child) -> None:
        """Wait for a random moment of a run."""
        until = time.monotonic() + self.dice.uniform(0, 1.1 * self.survey.run_s)
        while time.monotonic() < until and child.poll() is None:
            time.sleep(0.005)

    def _signal(self, sign: int) -> None:
        self._something_to_do()
        child = spl_batch(self.survey, "--workers", "0")
        self._moment(child)
        self._hit(child, sign)
        ends = {signal.SIGKILL: {DONE, -signal.SIGKILL}, signal.SIGTERM: {DONE, STOPPED}}
        self._judge(child, ends.get(signal.Signals(sign), {DONE}))

    def _hit(self, child: Child, sign: int) -> None:
        if child.poll() is not None:
            return
        with contextlib.suppress(ProcessLookupError):
            os.kill(child.pid, sign)
        if sign == signal.SIGSTOP:
            time.sleep(self.dice.uniform(0.1, 2.0))
            os.kill(child.pid, signal.SIGCONT)

    def _on_cluster(self, victim: str, *, stop: bool = False) -> None:
        self._something_to_do()
        address = self.cluster.ready()
        client = spl_batch(self.survey, "--scheduler", address, "--memory", "2GiB")
        self._moment(client)
        scheduler = self.cluster.scheduler
        if scheduler is None:
            raise HurtError("the cluster has no scheduler")
        hit = {"client": client, "scheduler": scheduler, "worker": self.cluster.workers[0]}[victim]
        self._hit(hit, signal.SIGSTOP if stop else signal.SIGKILL)
        if victim == "worker":
            self.cluster.ready()
        killed = {DONE} if stop or victim == "worker" else {DONE, STOPPED, -signal.SIGKILL}
        try:
            self._judge(client, killed)
        finally:
            if victim == "scheduler" and not stop:
                self.cluster.close()

    def _flip_in_a_run(self) -> None:
        self._something_to_do()
        child = spl_batch(self.survey, "--workers", "0")
        self._moment(child)
        self._damage("store", flip, "flipped during the run")
        self._judge(child, {DONE})

    def _full_disk(self) -> None:
        self._something_to_do()
        child = spl_batch(self.survey, "--workers", "0")
        self._moment(child)
        ballast = self.survey.folder / "ballast"
        free = shutil.disk_usage(self.survey.folder).free
        with contextlib.suppress(OSError), ballast.open("wb") as stream:
            os.posix_fallocate(
                stream.fileno(), 0, max(free - self.dice.choice([0, 20_000, 200_000]), 1)
            )
        try:
            self._judge(child, {DONE, STOPPED})
        finally:
            ballast.unlink(missing_ok=True)

    def _damage(self, place: str, harm: Callable[[Path], None], word: str) -> None:
        files = self.survey.files(place)
        if not files:
            return
        path = self.dice.choice(files)
        with contextlib.suppress(FileNotFoundError):
            harm(path)
        name = str(path.relative_to(self.survey.output))
        self.tally.append(f"{word}: {name}")
        if place == "output":
            self.survey.flipped.add(name)


def warm_up() -> None:
    """Load modules and kernels once, for all that is forked."""
    import distributed  # noqa: F401, PLC0415

    compile_share(0, 1)
    schemas()
    code_version("imaging")


def prepared(folder: Path, dice: random.Random) -> Survey:
    """Simulate the survey, and run each state untouched."""
    survey = Survey(folder, dice)
    simulate(parse_scene(SCENE, "benchmarks.soak"), folder)
    shutil.rmtree(folder / "truth", ignore_errors=True)
    for without in (False, True):
        for alpha in range(len(ALPHAS)):
            survey.alpha = alpha
            start = time.monotonic()
            child = spl_batch(survey, "--workers", "0")
            if child.wait() != DONE:
                sys.exit(child.text())
            survey.run_s = time.monotonic() - start
            survey.expected[alpha, without] = survey.results()
            shutil.rmtree(survey.output)
        survey.swap_line()
    survey.alpha = 0
    return survey


def table(soak: Soak, began: float) -> str:
    """Faults tried and survived."""
    lines = [f"{'fault':36s}{'tried':>8s}{'survived':>10s}"]
    lines += [f"{k:36s}{n:8d}{soak.survived[k]:10d}" for k, n in sorted(soak.tried.items())]
    total, kept = soak.tried.total(), soak.survived.total()
    minutes = (time.monotonic() - began) / 60
    lines.append(f"{f'all, in {minutes:.0f} min':36s}{total:8d}{kept:10d}")
    return "\n".join([*lines, *(f"DIFFERENCE: {text}" for text in soak.differences)])


def main(arguments: Sequence[str] | None = None) -> int:
    """Hurt a survey for a while; gives the number of differences."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--faults", type=int, default=ENDLESS, help="end after so many")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--folder", type=Path, help="by default a temporary one")
    parser.add_argument("--record", metavar="WHAT", help="add what came of it to the record")
    given = parser.parse_args(arguments)
    for sign in (signal.SIGINT, signal.SIGTERM):  # also where a shell had them ignored
        signal.signal(sign, signal.default_int_handler)
    top = given.folder or Path(tempfile.mkdtemp(prefix="soak"))
    top.mkdir(parents=True, exist_ok=True)
    dice = random.Random(given.seed)  # noqa: S311 - moments, no secret
    warm_up()
    with small_disk(top / "survey") as can_fill:
        if not can_fill:
            print("disks are not filled: this user may not mount a file system")
        survey = prepared(top / "survey", dice)
        cluster = Cluster(top / "cluster")
        cluster.folder.mkdir()
        soak, began = Soak(survey, cluster, dice, can_fill), time.monotonic()
        try:
            while (
                time.monotonic() - began < 60 * given.minutes and soak.tried.total() < given.faults
            ):
                soak.round()
                state = {"minutes": (time.monotonic() - began) / 60, "tried": soak.tried,
                         "survived": soak.survived, "differences": soak.differences}  # fmt: skip
                (top / "soak.json").write_text(json.dumps(state, indent=1))
        except KeyboardInterrupt:
            print("interrupted")
        finally:
            cluster.close()
        print(table(soak, began))
        if given.record:
            command = ["python", "-m", "benchmarks.soak", "--minutes", f"{given.minutes:g}"]
            command += ["--faults", str(given.faults)] if given.faults < ENDLESS else []
            command += ["--seed", str(given.seed)]
            faults.add(given.record, soak.tried.total(), soak.survived.total(), command)
    return len(soak.differences)


if __name__ == "__main__":
    sys.exit(bool(main()))
