"""Draw the null distribution that ships: ``python -m benchmarks.null_table [POINTS]``.

Writes ``spl_batch/stages/null_table.json`` for the default settings of the filter; POINTS
noise points are drawn for each density.
"""

import json
import sys
from importlib import resources
from pathlib import Path

import numpy as np

from spl_batch.settings import FilterSettings
from spl_batch.stages.null_distribution import FILE, draw_table, settings_key


def main(points: int) -> None:
    """Draw and write."""
    settings = FilterSettings()
    table = draw_table(
        settings, points, tell=lambda density: print(f"{density:9.5f} /m3", flush=True)
    )
    content = {
        "about": f"null distribution of the noise test; {points} noise points per density; "
        "made by python -m benchmarks.null_table",
        "settings": settings_key(settings),
        "density": table.density.round(5).tolist(),
        "level": table.level.round(5).tolist(),
        "alpha": table.alpha.round(5).tolist(),
        "score": table.score.round(3).tolist(),
        "own": np.minimum(table.own, table.alpha.round(5)).round(5).tolist(),
        "link_m": table.link_m.round(3).tolist(),
    }
    path = Path(str(resources.files("spl_batch.stages").joinpath(FILE)))
    rows = ",\n".join(f'"{name}": {json.dumps(value)}' for name, value in content.items())
    path.write_text("{\n" + rows.replace("], [", "],\n[") + "\n}\n", encoding="utf-8")
    print(f"{path}: {path.stat().st_size} bytes")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 500_000)
