"""Which kernels the airborne chain calls, and with what.

Run ``python -m benchmarks.airborne.signatures``.

Flies and runs the packaged tiny survey in this process and writes the types of the arguments of
each kernel that Python called to ``spl_batch/airborne/signatures.json``, from which workers
compile ahead. With ``--check`` it compares, and ends with status 1 where they differ. ``--flown``
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
        for name in sorted({*found, *known}):
            if found.get(name) != known.get(name):
                print(f"{name}: called with {found.get(name)}, listed with {known.get(name)}")
        return int(found != known)
    target = Path(str(files("spl_batch.airborne") / "signatures.json"))
    texts = {name: ",\n  ".join(map(json.dumps, listed)) for name, listed in found.items()}
    listed = (f' "{name}": [\n  {text}\n ]' for name, text in texts.items())
    target.write_text("{\n" + ",\n".join(listed) + "\n}\n", encoding="utf-8")
    print(f"{target}: {len(found)} kernels")
    return 0


def written(one: types.Type) -> Any:
    """Type of an argument as :func:`~spl_batch.airborne.precompile.parse` takes it."""
    if isinstance(one, types.Array):
        return ["array" if one.mutable else "readonly", str(one.dtype), one.ndim, one.layout]
    if isinstance(one, types.BaseTuple):
        members = one.types  # type: ignore[attr-defined]
        return [getattr(one, "instance_class", tuple).__name__, *map(written, members)]
    return str(one)


def called(workflow: Path) -> dict[str, list[list[Any]]]:
    """Types of the arguments of each kernel that a run calls from Python, by its name."""
    found: dict[str, set[str]] = {}
    first_call = Dispatcher._compile_for_args  # type: ignore[attr-defined]  # noqa: SLF001

    def heard(kernel: Any, *args: Any, **named: Any) -> Any:
        result = first_call(kernel, *args, **named)
        module = kernel.py_func.__module__
        home = sys.modules.get(module)
        if isinstance(getattr(home, kernel.py_func.__name__, None), Dispatcher) and (
            module.startswith("spl_batch.")
        ):
            name = f"{module}:{kernel.py_func.__name__}"
            passed = [written(kernel.typeof_pyval(arg)) for arg in args]
            found.setdefault(name, set()).add(json.dumps(passed))
        return result

    with (
        mock.patch.object(Dispatcher, "_compile_for_args", heard),
        mock.patch.object(summarise, "make_pictures", return_value={}),  # they call none
    ):
        api.run(workflow, workers=0)
    return {name: [json.loads(one) for one in sorted(found[name])] for name in sorted(found)}


if __name__ == "__main__":
    sys.exit(main())
