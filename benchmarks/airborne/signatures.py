"""Which kernels the airborne chain calls, and with what.

Run ``python -m benchmarks.airborne.signatures``.

Flies and runs the packaged tiny survey in this process and writes the types of the arguments of
each kernel that Python called to ``spl_batch/airborne/signatures.json``, from which a run compiles
ahead. With ``--check`` it compares, and ends with status 1 where they differ. ``--flown``
names the workflow of a tiny survey that is there already.
"""

import argparse
import json
import sys
import tempfile
from importlib.resources import files
from pathlib import Path
from typing import Any
from unittest import mock

from numba import types
from numba.core.dispatcher import Dispatcher

from spl_batch import api
from spl_batch.airborne import precompile
from spl_batch.airborne.report import summarise
from spl_batch.airborne.simulate import preset_scene, simulate
from spl_batch.airborne.steps import STEPS
from spl_batch.engine.watch.events import Event, TaskStarted

Listed = dict[str, dict[str, list[list[Any]]]]
"""Types of arguments by step and kernel."""


def main() -> int:
    """Write or compare."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="compare, write nothing")
    parser.add_argument("--flown", type=Path, help="workflow of that survey, not to fly it again")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        flown = given.flown or simulate(preset_scene("tiny"), Path(folder)).workflow
        found = called(flown)
    if given.check:
        known = precompile.signatures()
        for step in {**found, **known}:
            mine, theirs = found.get(step, {}), known.get(step, {})
            for name in sorted({*mine, *theirs}):
                if mine.get(name) != theirs.get(name):
                    print(f"{step}: {name}: called with {mine.get(name)}, "
                          f"listed with {theirs.get(name)}")  # fmt: skip
        return int(found != known)
    target = Path(str(files("spl_batch.airborne") / "signatures.json"))
    target.write_text(laid_out(found), encoding="utf-8")
    print(f"{target}: {sum(map(len, found.values()))} kernels")
    return 0


def written(one: types.Type) -> Any:
    """Type of an argument as :func:`~spl_batch.airborne.precompile.parse` takes it."""
    if isinstance(one, types.Array):
        return ["array" if one.mutable else "readonly", str(one.dtype), one.ndim, one.layout]
    if isinstance(one, types.BaseTuple):
        members = one.types  # type: ignore[attr-defined]
        return [getattr(one, "instance_class", tuple).__name__, *map(written, members)]
    return str(one)


def called(workflow: Path) -> Listed:
    """Types of the arguments of each kernel that a run calls from Python, by step and name.

    A kernel is listed under the step that is the first to call it with these types.
    """
    found: dict[str, dict[str, set[str]]] = {name: {} for name in STEPS}
    known, at = set[tuple[str, str]](), [""]
    first_call = Dispatcher._compile_for_args  # type: ignore[attr-defined]  # noqa: SLF001

    def begun(event: Event) -> None:
        if isinstance(event, TaskStarted):
            at[0] = event.kind

    def heard(kernel: Any, *args: Any, **named: Any) -> Any:
        result = first_call(kernel, *args, **named)
        module = kernel.py_func.__module__
        home = sys.modules.get(module)
        if isinstance(getattr(home, kernel.py_func.__name__, None), Dispatcher) and (
            module.startswith("spl_batch.")
        ):
            name = f"{module}:{kernel.py_func.__name__}"
            passed = json.dumps([written(kernel.typeof_pyval(arg)) for arg in args])
            if (name, passed) not in known:
                found[at[0]].setdefault(name, set()).add(passed)
            known.add((name, passed))
        return result

    with (
        mock.patch.object(Dispatcher, "_compile_for_args", heard),
        mock.patch.object(summarise, "make_pictures", return_value={}),  # they call none
    ):
        api.run(workflow, workers=0, listener=begun)
    return {
        step: {name: [json.loads(one) for one in sorted(of[name])] for name in sorted(of)}
        for step, of in found.items()
        if of
    }


def laid_out(found: Listed) -> str:
    """JSON with a line for each signature."""
    steps = []
    for step, kernels in found.items():
        texts = {name: ",\n   ".join(map(json.dumps, listed)) for name, listed in kernels.items()}
        of_step = (f'  "{name}": [\n   {text}\n  ]' for name, text in texts.items())
        steps.append(f' "{step}": {{\n' + ",\n".join(of_step) + "\n }")
    return "{\n" + ",\n".join(steps) + "\n}\n"


if __name__ == "__main__":
    sys.exit(main())
