"""What others take for a part of the work, on points of the same survey and in the same run.

For :mod:`benchmarks.stages` and :mod:`benchmarks.end_to_end`. Seconds of processor time per
million points on one core:

- the search for 15 neighbours alone, without any decision: scipy's cKDTree, and pykdtree and
  pgeof (nanoflann) in float32 where they are installed, with the points in the order of a tree;
- the same filter written plainly with scipy and numpy, full counts in float64;
- PDAL's outlier filters and its ground filter, from LAZ to nothing, where ``pdal`` is on the PATH.
"""

import functools
import importlib
import json
import os
import resource
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import laspy
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from benchmarks.denoise import TAIL, slow_labels
from spl_batch.kernels.kdtree import build

K: Final = 16
"""Neighbours that libraries are asked for: 15 and the point itself."""

SEARCHED, JUDGED = 400_000, 10_000
"""Points for the searches, and for the plain filter [count]."""

PIPELINES: Final[Mapping[str, list[dict[str, Any]]]] = {
    "PDAL, statistical outliers, k = 15": [
        {"type": "filters.outlier", "method": "statistical", "mean_k": 15, "multiplier": 2.0}
    ],
    "PDAL, outliers by radius": [
        {"type": "filters.outlier", "method": "radius", "radius": 1.5, "min_k": 6}
    ],
    "PDAL, outliers and ground": [
        {"type": "filters.outlier", "method": "statistical", "mean_k": 15, "multiplier": 2.0},
        {"type": "filters.smrf", "ignore": "Classification[7:7]"},
    ],
}


def middle(laz: Path, wanted: int) -> NDArray[np.int64]:
    """Points of an upright column through the middle of a file, in its order: (n, 3) [mm]."""
    with laspy.open(laz) as file:
        cloud = file.read()
    xyz = np.rint(np.asarray(cloud.xyz) * 1000.0).astype(np.int64)
    aside = np.abs(xyz[:, :2] - np.median(xyz[:, :2], axis=0)).max(axis=1)
    wanted = min(wanted, len(xyz))
    return xyz[aside <= np.partition(aside, wanted - 1)[wanted - 1]]


def searches(xyz: NDArray[np.int64]) -> Iterator[tuple[str, float]]:
    """Name and seconds per million of each search for 15 neighbours, trees included."""
    local = (xyz - xyz.min(axis=0)).astype(np.int32)
    places = np.ascontiguousarray(build(local).points[:3].T) / 1000.0
    yield "cKDTree, k = 15", _rate(len(places), lambda: cKDTree(places).query(places, k=K))
    single = places.astype(np.float32)
    for name, call in (("pykdtree", _pykdtree), ("pgeof", _pgeof)):
        try:
            module = importlib.import_module("pykdtree.kdtree" if name == "pykdtree" else name)
        except ImportError:
            continue
        search = functools.partial(call, module, single)
        yield f"{name} float32, k = 15", _rate(len(single), search)


def plain_filter(xyz: NDArray[np.int64]) -> tuple[str, float]:
    """Name and seconds per million of the filter in scipy and numpy."""
    return "plain scipy and numpy filter", _rate(len(xyz), lambda: slow_labels(xyz, TAIL))


def pdal(laz: Path) -> Iterator[tuple[str, float]]:
    """Name and seconds per million of each of PDAL's pipelines; nothing without PDAL."""
    program = shutil.which("pdal")
    if program is None:
        return
    with laspy.open(laz) as file:
        points = file.header.point_count
    for name, filters in PIPELINES.items():
        stages = [str(laz), *filters, {"type": "writers.null"}]
        with tempfile.NamedTemporaryFile("w", suffix=".json") as job:
            json.dump({"pipeline": stages}, job)
            job.flush()
            before = _of_children()
            subprocess.run([program, "pipeline", job.name], check=True)  # noqa: S603
            yield name, (_of_children() - before) / points * 1e6


def print_ratios(laz: Path, ours: Mapping[str, float]) -> None:
    """Measure all of them and print how often each goes into what ours takes [s / million]."""
    os.environ["OMP_NUM_THREADS"] = "1"
    found = [*searches(middle(laz, SEARCHED)), plain_filter(middle(laz, JUDGED)), *pdal(laz)]
    print(f"{'in the same run':36s}{'s / M':>9s}" + "".join(f"{f'{n} /':>12s}" for n in ours))
    for name, rate in found:
        ratios = "".join(f"{seconds / rate:12.2f}" for seconds in ours.values())
        print(f"{name:36s}{rate:9.2f}{ratios}")
    if shutil.which("pdal") is None:
        print("pdal is not on the PATH")


def _rate(points: int, call: Callable[[], Any]) -> float:
    start = time.process_time()
    call()
    return (time.process_time() - start) / points * 1e6


def _pykdtree(module: Any, places: NDArray[np.float32]) -> None:
    module.KDTree(places).query(places, k=K)


def _pgeof(module: Any, places: NDArray[np.float32]) -> None:
    module.knn_search(places, places, K)


def _of_children() -> float:
    """Processor time of processes that have ended [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
