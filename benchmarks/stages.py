"""What each stage costs: ``python -m benchmarks.stages OUTPUT [OUTPUT ...]``.

OUTPUT is a folder that ``spl-batch run`` has finished. Prints seconds per million input
returns and worker, points per second and peak memory of each stage, and the shares of the
whole. Run it on a machine that does nothing else; a first run compiles its kernels, so
run once with ``--fresh`` before measuring. Then, on points of the same survey and in this run,
what others take for a part of it (:mod:`benchmarks.peers`), with the ratio of the denoise stage
and of all stages to each. Where ``pdal`` is on the PATH and the survey was simulated, also what
share of its noise PDAL's outlier filters find.
"""

import json
import sys
from pathlib import Path

from benchmarks.peers import print_ratios


def main(output: Path) -> None:
    """Print the table of one run."""
    report = json.loads((output / "report.json").read_text(encoding="utf-8"))
    millions = report["counts"]["points_in"] / 1e6
    stages = report["performance"]["stages"]
    # What a reference says takes time by its own points, and is no part of the chain.
    stages.pop("report", None)
    total = sum(stage["wall_s"] for stage in stages.values())
    print(f"{output}: {millions:.2f} M returns, {report['performance']['workers']} workers")
    print(f"{'stage':10s}{'s / M':>9s}{'points/s':>12s}{'share %':>9s}{'MB':>8s}")
    for name, stage in stages.items():
        rate = report["counts"]["points_in"] / stage["wall_s"] if stage["wall_s"] else 0.0
        print(
            f"{name:10s}{stage['wall_s'] / millions:9.2f}{rate:12.0f}"
            f"{100 * stage['wall_s'] / total:9.1f}{stage['peak_rss_mb']:8.0f}"
        )
    print(f"{'all':10s}{total / millions:9.2f}{report['counts']['points_in'] / total:12.0f}")
    ours = {"denoise": stages["denoise"]["wall_s"] / millions, "all": total / millions}
    print_ratios(output, ours)


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit("usage: python -m benchmarks.stages OUTPUT [OUTPUT ...]")
    for folder in sys.argv[1:]:
        main(Path(folder))
