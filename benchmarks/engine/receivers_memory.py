"""Memory of the other receivers as their inputs grow.

Run ``python -m benchmarks.engine.receivers_memory``.

``granules FOLDER`` writes ATL03 files of once, twice, four and eight times 500 000 photons in one
beam, with an ATL08 file that classifies all of them, and runs each on one worker of 1 GiB, in
segments of 250 000 photons.

``frames FOLDER`` writes files of once, twice, four and eight times 10 000 frames of 32 x 32 pixels,
in HDF5 and in Zarr, and runs each likewise, 200 frames an acquisition.

``arrays FOLDER`` writes two acquisitions of 50 frames of arrays of 64 x 64 up to 512 x 512, and
runs them in this process: memory of a task above what the process held before.

The peak of a worker's process must not grow with what it has to read. ``python -m
benchmarks.engine.memory tasks WORKFLOW`` takes the same apart by kind of task.
"""

import argparse
import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest import mock

import h5py
import numpy as np
import yaml
import zarr
from numpy.typing import NDArray

from benchmarks.engine.peak import Peak
from spl_batch import api
from spl_batch.altimetry.simulate import Track, scene, simulate_track
from spl_batch.constants import SPEED_OF_LIGHT_M_S
from spl_batch.engine.flow import job
from spl_batch.engine.tasks import runner
from spl_batch.engine.tasks.task import Receipt

FACTORS = (1, 2, 4, 8)
PHOTONS = 500_000
SEGMENT_M, SPEED_M_S, PULSES_PER_S = 20.0, 7100.0, 10_000.0
FRAMES, PER = 10_000, 200
EDGES = (64, 128, 256, 512)
MEMORY = "1GiB"


def _appended(group: Any, name: str, values: NDArray[Any]) -> None:
    """Write values behind those that a dataset holds."""
    if name not in group:
        group.create_dataset(name, data=values, maxshape=(None,), chunks=(65_536,))
        return
    made = group[name]
    made.resize(len(made) + len(values), axis=0)
    made[-len(values) :] = values


def _granule(folder: Path, track: Track, copies: int) -> None:
    """ATL03 and ATL08 files of so many copies of a track, one behind the other."""
    count = int(np.ceil(track.along_m.max() / SEGMENT_M))
    segment = np.minimum((track.along_m / SEGMENT_M).astype(int), count - 1)
    photons = np.bincount(segment, minlength=count)
    inside = np.arange(len(segment)) - (np.cumsum(photons) - photons)[segment] + 1
    rate = track.background.per_m2 * SPEED_M_S * SPEED_OF_LIGHT_M_S / 2.0 / PULSES_PER_S
    with h5py.File(folder / "atl03.h5", "w") as file, h5py.File(folder / "atl08.h5", "w") as other:
        file.attrs["short_name"] = "ATL03"
        for copy in range(copies):
            before_m = 14e6 + copy * count * SEGMENT_M
            start = before_m + SEGMENT_M * np.arange(count)
            degrees = (before_m + track.along_m) / 111_000.0 - 126.0
            number = 700_000 + copy * count + np.arange(count)
            columns = {
                "gt1r/heights/h_ph": track.height_m.astype(np.float32),
                "gt1r/heights/dist_ph_along": (track.along_m - SEGMENT_M * segment).astype("f4"),
                "gt1r/heights/lat_ph": degrees,
                "gt1r/heights/lon_ph": np.full(len(segment), -104.0),
                "gt1r/geolocation/segment_dist_x": start,
                "gt1r/geolocation/segment_ph_cnt": photons.astype(np.int32),
                "gt1r/geolocation/segment_id": number.astype(np.int32),
                "gt1r/geolocation/delta_time": start / SPEED_M_S,
                "gt1r/bckgrd_atlas/delta_time": (before_m + track.background.along_m) / SPEED_M_S,
                "gt1r/bckgrd_atlas/bckgrd_rate": rate.astype(np.float32),
            }
            for name, values in columns.items():
                _appended(file, name, values)
            classes = {
                "classed_pc_flag": track.truth.astype(np.int8),
                "classed_pc_indx": inside.astype(np.int32),
                "ph_segment_id": number[segment].astype(np.int32),
                "delta_time": (start / SPEED_M_S)[segment],
            }
            for name, values in classes.items():
                _appended(other, f"gt1r/signal_photons/{name}", values)


def _run(workflow: Path, content: dict[str, Any]) -> Any:
    """Report of a run on one worker."""
    workflow.write_text(yaml.safe_dump({**content, "output": "out"}), encoding="utf-8")
    result = api.run(workflow, workers=1, memory=MEMORY, fresh=True)
    if result.report is None or result.exit_status:
        raise SystemExit(f"{workflow}: the run failed")
    return result.report


def _row(what: str, report: Any, first: Iterator[int]) -> None:
    stages = report.performance.stages
    if next(first) == 0:
        print(f"{'':24s}" + "".join(f"{name:>12s}" for name in stages) + "     [MiB, so far]")
    peaks = (stage.peak_rss_mb or 0.0 for stage in stages.values())
    print(f"{what:24s}" + "".join(f"{peak:12.0f}" for peak in peaks), flush=True)


def granules(folder: Path) -> None:
    """Print the peak of a worker on granules that grow."""
    wanted = scene(
        "mountain", "green", 11, length_m=12_000.0, signal_per_m=4.0, noise_per_m2=0.024, canopy=0.3
    )
    track, first = simulate_track(wanted), itertools.count()
    copies = -(-PHOTONS // len(track.along_m))
    for factor in FACTORS:
        here = folder / f"granule_{factor}"
        here.mkdir(parents=True, exist_ok=True)
        _granule(here, track, copies * factor)
        content = {
            "kind": "altimetry",
            "track": {"photons": "atl03.h5"},
            "reference": {"labels": "atl08.h5"},
            "work": {"segment_photons": 250_000},
        }
        report = _run(here / "workflow.yaml", content)
        _row(f"{report.counts.points_in:,} photons", report, first)


def _bins(rng: np.random.Generator, frames: int, rows: int, cols: int) -> NDArray[np.uint16]:
    """Frames of a target that nine in ten pixels see."""
    drawn = rng.normal(400.0, 6.0, (frames, rows, cols)).astype(np.uint16)
    return np.where(rng.random((frames, rows, cols)) < 0.9, drawn, 0).astype(np.uint16)


def _frames_file(path: Path, frames: int) -> None:
    """A file of frames, written in parts."""
    shape, chunks = (frames, 32, 32), (1000, 32, 32)
    rng = np.random.default_rng(11)
    if path.suffix == ".zarr":
        array = zarr.open_group(path, mode="w").create_array(
            "frames", shape=shape, dtype="u2", chunks=chunks
        )
        for start in range(0, frames, 1000):
            array[start : start + 1000] = _bins(rng, 1000, 32, 32)
        return
    with h5py.File(path, "w") as file:
        made = file.create_dataset("frames", shape, "u2", chunks=chunks, compression="gzip")
        for start in range(0, frames, 1000):
            made[start : start + 1000] = _bins(rng, 1000, 32, 32)


def frames(folder: Path) -> None:
    """Print the peak of a worker on files of frames that grow."""
    for suffix in (".h5", ".zarr"):
        first = itertools.count()
        for factor in FACTORS:
            here = folder / f"frames_{factor}"
            here.mkdir(parents=True, exist_ok=True)
            _frames_file(here / f"frames{suffix}", FRAMES * factor)
            content = {
                "kind": "water_surface",
                "survey": {"frames": f"frames{suffix}"},
                "surface": {"frames_per_acquisition": PER},
            }
            report = _run(here / "workflow.yaml", content)
            _row(f"{FRAMES * factor:,} frames, {suffix}", report, first)


def arrays(folder: Path) -> None:
    """Print the memory of the tasks of arrays that grow, by pixel."""
    plain = runner.run_task
    print(f"{'pixels':>9s}{'task':>18s}{'MiB':>8s}{'bytes / pixel':>15s}")
    for edge in EDGES:
        folder.mkdir(parents=True, exist_ok=True)
        rng = np.random.default_rng(11)
        with h5py.File(folder / "frames.h5", "w") as file:
            made = file.create_dataset("frames", (100, edge, edge), "u2", chunks=(1, edge, edge))
            for k in range(100):
                made[k] = _bins(rng, 1, edge, edge)[0]
        content = {
            "kind": "water_surface",
            "survey": {"frames": "frames.h5"},
            "camera": {"rows": edge, "cols": edge},
            "surface": {"frames_per_acquisition": 50},
            "output": "out",
        }
        workflow = folder / "workflow.yaml"
        workflow.write_text(yaml.safe_dump(content), encoding="utf-8")
        most: dict[str, int] = {}

        def watched(task: Any, key: str, context: Any, most: dict[str, int] = most) -> Receipt:
            with Peak().watching() as peak:
                receipt = plain(task, key, context)
            most[task.kind] = max(most.get(task.kind, 0), peak.highest - peak.before)
            return receipt

        with mock.patch.object(job, "run_task", watched):
            api.run(workflow, workers=0, fresh=True, until="deliver")
        for kind, held in most.items():
            each = held / edge**2
            print(f"{edge**2:9,d}{kind:>18s}{held / 2**20:8.1f}{each:15.0f}", flush=True)


def main() -> None:
    """Print the table that is asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=["granules", "frames", "arrays"])
    parser.add_argument("folder", type=Path)
    given = parser.parse_args()
    {"granules": granules, "frames": frames, "arrays": arrays}[given.what](given.folder)


if __name__ == "__main__":
    main()
