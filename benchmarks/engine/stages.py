"""What each stage costs: ``python -m benchmarks.engine.stages OUTPUT [OUTPUT ...]``.

OUTPUT is a folder that ``spl-batch run`` has finished. Prints seconds per million input
returns and worker, points per second and peak memory of each stage, and the shares of the
whole; then what the command took beside its stages: the comparison with a reference, and what
workers were there for but did no task, as start-up, compiling and the writing of the report.
Run it on a machine that does nothing else; a first run compiles its kernels, so
run once with ``--fresh`` before measuring. Then, on points of the same survey and in this run,
what others take for a part of it (:mod:`benchmarks.airborne.peers`), with the ratio of the denoise
stage
and of all stages to each. Where ``pdal`` is on the PATH and the survey was simulated, also what
share of its noise PDAL's outlier filters find.
"""

import argparse
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from benchmarks.airborne.peers import print_ratios


def main(output: Path) -> None:
    """Print the table of one run."""
    report = json.loads((output / "report.json").read_text(encoding="utf-8"))
    millions = report["counts"]["points_in"] / 1e6
    stages = report["performance"]["stages"]
    # What a reference says takes time by its own points, and is no part of the chain.
    compared = stages.pop("report", {"wall_s": 0.0})["wall_s"]
    total = sum(stage["wall_s"] for stage in stages.values())
    print(f"{output}: {millions:.2f} M returns, workers: {report['performance']['workers']}")
    print(f"{'stage':10s}{'s / M':>9s}{'points/s':>12s}{'share %':>9s}{'MB':>8s}")
    for name, stage in stages.items():
        rate = report["counts"]["points_in"] / stage["wall_s"] if stage["wall_s"] else 0.0
        print(
            f"{name:10s}{stage['wall_s'] / millions:9.2f}{rate:12.0f}"
            f"{100 * stage['wall_s'] / total:9.1f}{stage['peak_rss_mb']:8.0f}"
        )
    print(f"{'all':10s}{total / millions:9.2f}{report['counts']['points_in'] / total:12.0f}")
    for name, seconds in beside(report["performance"], total + compared, compared):
        share = 100 * seconds / total
        print(f"{name:34s}{seconds / millions:9.2f} s / M{share:9.1f} % of all above")
    ours = {"denoise": stages["denoise"]["wall_s"] / millions, "all": total / millions}
    print_ratios(output, ours)


def beside(
    performance: Mapping[str, Any], tasks_s: float, compared_s: float
) -> Iterator[tuple[str, float]]:
    """Name and time of workers that is no part of the chain's stages [s].

    Parameters
    ----------
    performance : mapping
        That of the report.
    tasks_s : float
        Summed time of all tasks [s].
    compared_s : float
        That of the comparison with a reference [s].
    """
    yield "report: compared with a reference", compared_s
    wall_s, workers = performance["wall_s"], performance["workers"] or 1
    if performance["earlier_wall_s"] or wall_s is None:
        return  # of a continued run nothing tells what its workers waited for
    compiling_s = (performance["compile_s"] or 0.0) * workers
    yield "compiling, once", compiling_s
    yield "start-up, waiting, report written", wall_s * workers - tasks_s - compiling_s


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("outputs", nargs="+", type=Path, metavar="output", help="of finished runs")
    for folder in parser.parse_args().outputs:
        main(folder)
