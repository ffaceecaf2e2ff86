"""What a run reads of each format, and what every file must lead to: values, or one clear fault.

A reader gives the number of things that it read. Whatever a file has become, it raises nothing but
the project's own errors, in one line that names the file, soon, and in little memory.
"""

import resource
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import laspy
import numpy as np
from pyproj import CRS

from spl_batch.altimetry.formats.atl08 import find_labels
from spl_batch.altimetry.formats.photons import inspect as inspect_track
from spl_batch.altimetry.formats.photons import iter_photons
from spl_batch.altimetry.formats.terrain import sample_terrain
from spl_batch.errors import SplBatchError
from spl_batch.formats.las.header import read_header
from spl_batch.formats.las.known_records import broken_records
from spl_batch.formats.las.reader import inspect, iter_points, read_ends
from spl_batch.formats.las.writer import KEEP_CLASS, write_classified
from spl_batch.formats.trajectory.positions import gathering
from spl_batch.formats.trajectory.records import has_records
from spl_batch.formats.vector_files import contains, read_polygons
from spl_batch.geiger.coincidence import files
from spl_batch.geiger.coincidence.settings import ArraySettings
from spl_batch.geiger.coincidence.tables import Detections, Frames
from spl_batch.geiger.water.formats import inspect_frames, iter_frames, read_truth
from tests import surveys
from tests.fuzz.seeds import seed

LIMIT_S: Final = 60.0
"""A file that takes more time of the processor hangs [s]: others may keep the machine busy."""

LIMIT_BYTES: Final = 600 << 20
"""Memory that a small file may make a reader take [byte]."""

MESSAGE_MAX: Final = 4000
"""Every fault of a file, in one message [character]."""


class BrokenPromiseError(AssertionError):
    """A reader did what it must not."""


def read_las(path: Path) -> int:
    """Look at a file as a plan does, read it as a run does, deliver it, and open that."""
    facts = inspect(path)
    list(broken_records(read_header(path)))
    channel = "channel" if "channel" in facts.dimensions else None
    read_ends(path, channel, 100)
    read = sum(len(table) for table in iter_points(path, channel_dimension=channel, source=1))
    if read != facts.n_points:
        raise BrokenPromiseError(f"{read} points of {facts.n_points}")

    def labels(start: int, stop: int) -> dict[str, np.ndarray]:
        given = np.full(stop - start, KEEP_CLASS, np.uint8)
        return {"classification": given, "noise_class": np.zeros_like(given),
                "input_classification": given}  # fmt: skip

    target = path.with_name("delivered.laz")
    write_classified(path, target, labels=labels, diagnostics=False, crs=facts.crs)
    delivered = laspy.read(target)
    if len(delivered.points) != read:
        raise BrokenPromiseError(f"{len(delivered.points)} points delivered of {read}")
    return read


def read_trajectory(path: Path) -> int:
    """Ends, then all records in order."""
    has_records(path)
    found = 0
    crs = CRS.from_epsg(32615)
    with gathering([path], survey_crs=crs, trajectory_crs=None) as records:
        for times, _ in records:
            found += len(times)
    return found


def read_raster(path: Path) -> int:
    """Terrain heights at some points."""
    latitude, longitude = np.linspace(29.99, 30.02, 40), np.full(40, -104.01)
    return int(np.isfinite(sample_terrain(path, latitude, longitude)).sum())


def read_area(path: Path) -> int:
    """Polygons, and which points lie in them."""
    area = read_polygons(path, CRS.from_epsg(32615))
    x, y = (np.linspace(v - 30, v + 30, 50) * 1000 for v in surveys.ORIGIN_M)
    return int(contains(area, x.astype(np.int64), y.astype(np.int64)).sum())


def read_track(path: Path) -> int:
    """Photons of each beam."""
    facts, found = inspect_track(path), 0
    for beam in facts.beams:
        found += sum(p.read for p in iter_photons(path, facts.layout, beam.name, 1000))
    return found


def read_classes(path: Path) -> int:
    """Classes of an ATL03 beam's photons."""
    photons = path.with_name("photons.h5")
    photons.write_bytes(seed("atl03").content)
    found = find_labels(photons, [path], "gt1r")
    if found is None:
        return 0
    return int(found.signal.sum())


def read_frames(path: Path) -> int:
    """Frames and their truth."""
    facts = inspect_frames(path, 4, 5)
    found = sum(len(frames) for _, frames in iter_frames(path, 0, facts.frames, 1000))
    if facts.truth_frames:
        read_truth(path, 0, facts.frames // facts.truth_frames)
    return found


def read_l1_frames(path: Path) -> int:
    """Frames in order."""
    files.inspect(path, Frames.types())
    files.extents(path)
    return len(files.read_frames(path))


def read_l1_detections(path: Path) -> int:
    """Detections in order."""
    files.inspect(path, Detections.types())
    files.extents(path)
    return sum(map(len, files.read_detections(path, ArraySettings())))


READERS: Final[dict[str, Callable[[Path], int]]] = {
    **dict.fromkeys(("las 1.2", "las 1.4", "laz 1.2", "laz 1.4", "copc"), read_las),
    **dict.fromkeys(("trajectory csv", "trajectory parquet", "trajectory sbet"), read_trajectory),
    "geotiff": read_raster,
    **dict.fromkeys(("gpkg", "geojson"), read_area),
    **dict.fromkeys(("atl03", "mabel", "track csv"), read_track),
    "atl08": read_classes,
    "frames": read_frames,
    "l1 frames": read_l1_frames,
    "l1 detections": read_l1_detections,
}
"""What reads a format of :data:`~tests.fuzz.seeds.SEEDS`."""


def attempt(name: str, content: bytes, folder: Path) -> bool:
    """Read a mutant; whether it could be read.

    Raises
    ------
    BrokenPromiseError
        If it leads to anything but values or a fault, takes long, or takes much memory.
    """
    path = folder / f"mutant{seed(name).suffix}"
    path.write_bytes(content)
    begin_s = time.process_time()
    try:
        with little_memory():
            READERS[name](path)
        sound = True
    except SplBatchError as error:
        sound = False
        message = str(error)
        if "\n" in message or not message.isprintable() or len(message) > MESSAGE_MAX:
            raise BrokenPromiseError(f"no clear line: {message[:2000]!r}") from error
    took_s = time.process_time() - begin_s
    if took_s > LIMIT_S:
        raise BrokenPromiseError(f"took {took_s:.0f} s")
    return sound


@contextmanager
def little_memory() -> Iterator[None]:
    """Forbid a block to take much more memory than there is in use, as Linux counts it.

    Raises
    ------
    BrokenPromiseError
        If its peak was higher.
    """
    before = resource.getrlimit(resource.RLIMIT_AS)
    status = Path("/proc/self/status")
    if not status.exists():
        yield
        return
    Path("/proc/self/clear_refs").write_text("5")
    now, used = (_kib(status, name) << 10 for name in ("VmSize", "VmRSS"))
    # A guard for the machine: what asks for more is refused there and then.
    resource.setrlimit(resource.RLIMIT_AS, (now + 8 * LIMIT_BYTES, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)
    peak = _kib(status, "VmHWM") << 10
    if peak - used > LIMIT_BYTES:
        raise BrokenPromiseError(f"took {(peak - used) >> 20} MiB")


def _kib(status: Path, name: str) -> int:
    """A line of a process's status [KiB]."""
    with status.open() as lines:
        return int(next(x for x in lines if x.startswith(f"{name}:")).split()[1])
