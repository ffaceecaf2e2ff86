"""What ``plan`` expects beside what the run takes: ``python -m benchmarks.plan_cost FOLDER``.

Five unlike surveys, simulated into FOLDER once: a square, the same with every delivery, one that is
mostly noise, a sparse one of many tiles, and one of many small files. Prints the plan's time,
the run's from Enter to prompt and their ratio. Kernels are compiled before.
"""

import argparse
import re
import shutil
from pathlib import Path
from typing import Final

import laspy

from benchmarks import end_to_end
from spl_batch import api
from spl_batch.airborne.precompile import compile_all

ALL: Final = ("outputs.copc=true", "outputs.tiles=laz", "outputs.contour_interval=1")
"""Deliveries that are made on request."""

POINTS_OF_A_FILE: Final = 5_000
"""Points of a small file [count]."""

SURVEYS: Final = {
    "square of 300 m": ((300.0, end_to_end.FORTY, 1.0), ()),
    "the same, COPC, tiles, contours": ((300.0, end_to_end.FORTY, 1.0), ALL),
    "square of 200 m, mostly noise": ((200.0, 0.2, 1.0), ()),
    "square of 2000 m, sparse": ((2000.0, 0.0005, 0.04), ()),
    "square of 300 m, small files": ((300.0, end_to_end.FORTY, 0.3), ()),
}
"""Side [m], background [1/m3] and density of each survey, and its settings."""


def main() -> None:
    """Simulate, plan and run each survey."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    compile_all()
    for name, (of_scene, settings) in SURVEYS.items():
        place = folder / "_".join(map(str, of_scene))
        workflow = end_to_end.survey(place, end_to_end.scene(*of_scene))
        output = folder / re.sub("[^a-z0-9]+", "_", name)
        shutil.rmtree(output, ignore_errors=True)  # its rates would be those of the plan
        overrides = [*settings, f"output={output}"]
        if "small files" in name:
            split(workflow.parent / "flightlines", place / "small")
            overrides.append(f"survey.flightlines={place}/small/*.laz")
        cost = api.plan(workflow, overrides=overrides).cost
        arguments = [part for value in overrides for part in ("--set", value)]
        took_s = end_to_end.command("run", workflow, "--fresh", *arguments)
        size = f"{cost.points / 1e6:.2f} M returns, {cost.tasks} tasks"
        ratio = took_s / cost.time_s
        print(f"{name}: {size}; plan {cost.time_s:.0f} s, run {took_s:.0f} s, {ratio:.2f} of it")


def split(clouds: Path, out: Path) -> None:
    """Cut clouds into small ones, unless that is done."""
    if out.exists():
        return
    out.mkdir(parents=True)
    for path in sorted(clouds.glob("*.laz")):
        with laspy.open(path) as source:
            for number, points in enumerate(source.chunk_iterator(POINTS_OF_A_FILE)):
                with laspy.open(out / f"{path.stem}_{number}.laz", "w", header=source.header) as to:
                    to.write_points(points)


if __name__ == "__main__":
    main()
