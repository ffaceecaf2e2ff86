"""Draw what ships of the noise test's null distribution.

Run ``python -m benchmarks.airborne.filter.null_table``.

Options: ``--points N`` noise points per density where noise is usual, 0.01-2 per m3, a fourth of
it elsewhere; ``--only score`` or ``wires`` for one of the two files.

Writes ``spl_batch/airborne/filter/ellipsoid/null_table.json`` and ``wire_null.json`` for the
default settings of the
filter and of its scan for conductors, whose share of pure noise by density it prints.
"""

import argparse
import json
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.filter.ellipsoid import null_distribution as null
from spl_batch.airborne.filter.wires import wire_null
from spl_batch.airborne.settings import FilterSettings

USUAL = (0.01, 2.0)
"""Noise densities where more is drawn [1/m3]."""

STRICTER = 0.1
"""Part of the scan's alpha at which a second share is drawn, for the power of alpha."""

ALIKE = 2.0
"""Shares of the scan that differ by more have a step between them [ratio]."""


def write(package: str, name: str, content: Mapping[str, Any]) -> None:
    """Write one file of the package, a row of numbers a line."""
    path = Path(str(resources.files(package).joinpath(name)))
    rows = ",\n".join(f'"{key}": {json.dumps(value)}' for key, value in content.items())
    path.write_text("{\n" + rows.replace("], [", "],\n[") + "\n}\n", encoding="utf-8")
    print(f"{path}: {path.stat().st_size} bytes")


def scores(points: int) -> None:
    """Table of the point-wise test."""
    settings = FilterSettings()
    densities = null.DENSITIES
    usual = (densities > USUAL[0]) & (densities < USUAL[1])
    table = null.draw_table(settings, np.where(usual, points, points // 4))
    content = {
        "about": f"null distribution of the noise test; {points} noise points per density, a "
        f"fourth beyond {USUAL[0]:g}-{USUAL[1]:g} per m3; made by "
        "python -m benchmarks.airborne.filter.null_table",
        "settings": null.settings_key(settings, null.IRRELEVANT),
        "density": table.density.round(5).tolist(),
        "level": table.level.round(5).tolist(),
        "alpha": table.alpha.round(5).tolist(),
        "score": table.score.round(3).tolist(),
        "own": np.minimum(table.own, table.alpha.round(5)).round(5).tolist(),
        "link_m": table.link_m.round(3).tolist(),
    }
    write(null.__name__.rpartition(".")[0], null.FILE, content)


def smoothed_between_steps(share: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean of each share and of those beside it, up to two, that are :data:`ALIKE`."""
    padded = np.pad(share, 2, constant_values=np.nan)
    near = np.lib.stride_tricks.sliding_window_view(padded, 5)
    alike = (near <= ALIKE * share[:, None]) & (ALIKE * near >= share[:, None])
    smooth: NDArray[np.float64] = np.where(alike, near, 0.0).sum(axis=1) / alike.sum(axis=1)
    return smooth


def wires(points: int) -> None:
    """Table of the scan for conductors."""
    settings = FilterSettings().wires
    stricter = settings.model_copy(update={"alpha": settings.alpha * STRICTER})
    share = wire_null.draw_shares(settings, points).round(6)
    # for one number, all densities together
    less = wire_null.draw_shares(stricter, points // 8)
    power = float(np.log(share.sum() / less.sum()) / -np.log(STRICTER))
    smooth = smoothed_between_steps(share)
    print(
        f"the scan keeps of pure noise, at its alpha of {settings.alpha:g} and {stricter.alpha:g}"
    )
    for row in zip(wire_null.DENSITIES, share, less, smooth, strict=True):
        print("{:9.4f} /m3   {:8.4%}   {:8.4%}   smoothed {:8.4%}".format(*row))
    print(f"power of alpha {power:.2f}")
    content = {
        "about": f"pure noise kept by the scan for conductors; {points} noise points per density; "
        "made by "
        "python -m benchmarks.airborne.filter.null_table",
        "settings": null.settings_key(settings, wire_null.IRRELEVANT),
        "density": np.log(wire_null.DENSITIES).round(5).tolist(),
        "share": [float(f"{s:.4g}") for s in smooth],
        "power": round(power, 3),
    }
    write(wire_null.__name__.rpartition(".")[0], wire_null.FILE, content)


def main() -> None:
    """Draw and write."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--points", type=int, default=2_000_000)
    parser.add_argument("--only", choices=("score", "wires"))
    options = parser.parse_args()
    if options.only != "score":
        wires(options.points)
    if options.only != "wires":
        scores(options.points)


if __name__ == "__main__":
    main()
