"""What others take for a part of the work, on points of the same survey and in the same run.

For :mod:`benchmarks.end_to_end`. Seconds of processor
time per million points on one core:

- the search for 15 neighbours alone, without any decision: scipy's cKDTree, and pykdtree and
  pgeof (nanoflann) in float32 where they are installed, with the points in the order of a tree;
- PDAL's outlier filters and its ground filter, all files together and from LAZ to LAZ, where
  ``pdal`` is on the PATH; and, where the survey was simulated, what they find of its noise.
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
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import laspy
import numpy as np
import pyarrow.parquet as pq
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from benchmarks.held.truth import NOISE
from spl_batch.constants import CLASS_HIGH_NOISE, CLASS_LOW_NOISE
from spl_batch.numerics.neighbours.kdtree import build

K: Final = 16
"""Neighbours that libraries are asked for: 15 and the point itself."""

SEARCHED = 400_000
"""Points for the searches [count]."""

STATISTICAL: Final = {
    "type": "filters.outlier", "method": "statistical", "mean_k": 15, "multiplier": 2.0
}  # fmt: skip
BY_RADIUS: Final = {"type": "filters.outlier", "method": "radius", "radius": 1.5, "min_k": 6}

PIPELINES: Final[Mapping[str, list[dict[str, Any]]]] = {
    "PDAL, reads and writes": [],
    "PDAL, statistical outliers, k = 15": [STATISTICAL],
    "PDAL, outliers by radius": [BY_RADIUS],
    "PDAL, the same and ground": [
        BY_RADIUS,
        {"type": "filters.smrf", "ignore": "Classification[7:7]"},
    ],
}
"""What is done to the points between reading and writing. The statistical filter is no filter for
a survey half of which is noise, so that the one by radius comes before the ground."""


def middle(laz: Path, wanted: int) -> NDArray[np.int64]:
    """Points of an upright column through the middle of a file, in its order: (n, 3) [mm]."""
    with laspy.open(laz) as file:
        cloud = file.read()
    xyz = np.rint(np.asarray(cloud.xyz) * 1000.0).astype(np.int64)
    aside = np.abs(xyz[:, :2] - np.median(xyz[:, :2], axis=0)).max(axis=1)
    wanted = min(wanted, len(xyz))
    found: NDArray[np.int64] = xyz[aside <= np.partition(aside, wanted - 1)[wanted - 1]]
    return found


def searches(xyz: NDArray[np.int64]) -> Iterator[tuple[str, float]]:
    """Name and seconds per million of each search for 15 neighbours, trees included."""
    local = (xyz - xyz.min(axis=0)).astype(np.int32)
    places = np.ascontiguousarray(build(local).points[:3].T) / 1000.0
    yield "cKDTree, k = 15", _rate(len(places), lambda: cKDTree(places).query(places, k=K))
    single = places.astype(np.float32)
    for name, search in installed():
        yield name, _rate(len(single), functools.partial(search, single))


def installed() -> Iterator[tuple[str, Callable[[NDArray[np.float32]], None]]]:
    """Name of each search in float32 that is there, and the search; of others it says so."""
    for library, call in SEARCHES.items():
        try:
            module = importlib.import_module(library)
        except ImportError:
            print(f"{library} is not installed")
            continue
        yield f"{library.split('.')[0]} float32, k = 15", functools.partial(call, module)


def pipeline(clouds: Sequence[Path], filters: list[dict[str, Any]], to: Path) -> dict[str, Any]:
    """PDAL's description of a job: files as one cloud without classes, filters, one LAZ file.

    The reader is named, as PDAL would take another for ``.copc.laz``, which gives points in
    another order. Classes are taken away: clouds that have been delivered say what noise is.
    """
    stages = [{"type": "readers.las", "filename": str(cloud)} for cloud in clouds]
    merge = {"type": "filters.merge"}
    forget = {"type": "filters.assign", "value": "Classification = 1"}
    writer = {
        "type": "writers.las", "filename": str(to), "forward": "all", "extra_dims": "all",
        "minor_version": 4, "offset_x": "auto", "offset_y": "auto", "offset_z": "auto",
    }  # fmt: skip
    return {"pipeline": [*stages, merge, forget, *filters, writer]}


def pdal(clouds: Sequence[Path]) -> Iterator[tuple[str, float, NDArray[np.uint8]]]:
    """Name, seconds per million and classes of each of PDAL's pipelines; nothing without PDAL.

    Nothing is streamed, as the filters need all points at once and the first pipeline is what the
    others spend on reading and writing. Classes are in the order of the files and of their points;
    where a filter for the ground gave them they may be in another order.
    """
    program = shutil.which("pdal")
    if program is None:
        return
    for name, filters in PIPELINES.items():
        with tempfile.TemporaryDirectory() as folder:
            job, result = Path(folder) / "job.json", Path(folder) / "result.laz"
            job.write_text(json.dumps(pipeline(clouds, filters, result)), encoding="utf-8")
            before = _of_children()
            subprocess.run([program, "pipeline", "--nostream", str(job)], check=True)  # noqa: S603
            seconds = _of_children() - before
            classes = classes_of([result])
        yield name, seconds / len(classes) * 1e6, classes


def version() -> str:
    """What PDAL says that it is, or that it is not there."""
    program = shutil.which("pdal")
    if program is None:
        return "pdal is not on the PATH"
    done = subprocess.run([program, "--version"], check=True, capture_output=True, text=True)  # noqa: S603
    return next(line for line in done.stdout.splitlines() if line.startswith("pdal"))


def classes_of(clouds: Sequence[Path]) -> NDArray[np.uint8]:
    """Classes of files, one after another: (n,)."""
    return np.concatenate([np.asarray(laspy.read(cloud).classification) for cloud in clouds])


def true_noise(clouds: Sequence[Path], truth: Path) -> NDArray[np.bool_]:
    """Which points of delivered clouds a simulation made as noise: (n,)."""
    tables = [pq.read_table(truth / f"{cloud.stem}.parquet", columns=["kind"]) for cloud in clouds]
    kinds = np.concatenate([table["kind"].to_numpy() for table in tables])
    return np.isin(kinds, NOISE)


def called_noise(classes: NDArray[np.uint8], noise: NDArray[np.bool_]) -> tuple[float, float]:
    """Shares of noise and of signal that classes call noise [%]."""
    called = np.isin(classes, (CLASS_LOW_NOISE, CLASS_HIGH_NOISE))
    return 100.0 * float(called[noise].mean()), 100.0 * float(called[~noise].mean())


def print_ratios(output: Path, ours: Mapping[str, float]) -> None:
    """Measure all of them and print how often each goes into what ours takes [s / million].

    Parameters
    ----------
    output : Path
        Folder of a finished run. Searches take points of its largest cloud.
    ours : mapping of str to float
        What parts of the chain took [s / million].
    """
    os.environ["OMP_NUM_THREADS"] = "1"
    clouds = sorted((output / "laz").rglob("*.laz"))
    largest = max(clouds, key=lambda cloud: cloud.stat().st_size)
    found = list(searches(middle(largest, SEARCHED)))
    theirs = list(pdal(clouds))
    print(f"{'in the same run':36s}{'s / M':>9s}" + "".join(f"{f'{n} /':>12s}" for n in ours))
    for name, rate in [*found, *((name, rate) for name, rate, _ in theirs)]:
        ratios = "".join(f"{seconds / rate:12.2f}" for seconds in ours.values())
        print(f"{name:36s}{rate:9.2f}{ratios}")
    print(version())
    truth = output.parent / "truth"
    if theirs and all((truth / f"{cloud.stem}.parquet").exists() for cloud in clouds):
        noise = true_noise(clouds, truth)
        print(f"{'called noise [%]':36s}{'of noise':>9s}{'of signal':>12s}")
        alone = [(n, c) for n, _, c in theirs if PIPELINES[n] in ([STATISTICAL], [BY_RADIUS])]
        for name, classes in [("ours", classes_of(clouds)), *alone]:
            of_noise, of_signal = called_noise(classes, noise)
            print(f"{name:36s}{of_noise:9.1f}{of_signal:12.2f}")


def _rate(points: int, call: Callable[[], Any]) -> float:
    start = time.process_time()
    call()
    return (time.process_time() - start) / points * 1e6


def _pykdtree(module: Any, places: NDArray[np.float32]) -> None:
    module.KDTree(places).query(places, k=K)


def _pgeof(module: Any, places: NDArray[np.float32]) -> None:
    module.knn_search(places, places, K)


SEARCHES: Final[Mapping[str, Callable[[Any, NDArray[np.float32]], None]]] = {
    "pykdtree.kdtree": _pykdtree,
    "pgeof": _pgeof,
}
"""Searches in float32 by the module that has them; ``pip install pykdtree pgeof``."""


def _of_children() -> float:
    """Processor time of processes that have ended [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
