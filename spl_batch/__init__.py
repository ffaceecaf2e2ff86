"""Raw single-photon lidar surveys to clean point clouds and terrain, whole surveys overnight.

The functions on arrays are imported when they are asked for.
"""

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

__all__ = [
    "ExpectedNoise",
    "Labels",
    "Rasters",
    "__version__",
    "expected_noise",
    "filter_points",
    "ground_points",
    "rasterize",
]


def __getattr__(name: str) -> Any:
    # Receipts know code by its imports: named as text, those of this file do not count for all.
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module("spl_batch.api"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
