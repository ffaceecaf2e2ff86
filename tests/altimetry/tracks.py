"""Small photon files of every layout, and runs on them."""

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow.parquet as pq
import yaml
from numpy.typing import NDArray

from benchmarks.altimetry.photon_beams import lattice, scene
from spl_batch.altimetry.simulate import Track, simulate_track

FIRST_SEGMENT = 700_001
ORIGIN_M = 14_000_020.0
SEGMENT_M = 20.0
SPEED_M_S = 7100.0


def small_track(seed: int = 1, **changes: Any) -> Track:
    """A flat track of 600 m with a gate of 200 m."""
    wanted = {"length_m": 600.0, "above_m": 120.0, "below_m": 80.0, **changes}
    return simulate_track(scene("flat", "green", seed, **wanted))


def photons_of(track: Track) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Photons of a track on the lattice."""
    return lattice(track.along_m, track.height_m)


def write_atl03(path: Path, tracks: dict[str, Track]) -> Path:
    """An ATL03 file with what this project reads, and one dataset that it does not."""
    with h5py.File(path, "w") as file:
        file.attrs["short_name"] = "ATL03"
        for beam, track in tracks.items():
            count = int(np.ceil(track.along_m.max() / SEGMENT_M)) + 1
            segment = np.minimum((track.along_m / SEGMENT_M).astype(int), count - 1)
            start = ORIGIN_M + SEGMENT_M * np.arange(count)
            group = file.create_group(beam)
            heights = {
                "h_ph": track.height_m.astype(np.float32),
                "dist_ph_along": (track.along_m - SEGMENT_M * segment).astype(np.float32),
                "lat_ph": 30.0 + track.along_m / 111_000.0,
                "lon_ph": np.full(len(track.along_m), -104.0),
                "quality_ph": np.zeros(len(track.along_m), np.int8),
            }
            geolocation = {
                "segment_dist_x": start,
                "segment_ph_cnt": np.bincount(segment, minlength=count).astype(np.int32),
                "segment_id": FIRST_SEGMENT + np.arange(count, dtype=np.int32),
                "delta_time": start / SPEED_M_S,
            }
            groups = {"heights": heights, "geolocation": geolocation}
            for name, columns in groups.items():
                for key, values in columns.items():
                    group.create_dataset(f"{name}/{key}", data=values)
    return path


def write_atl08(path: Path, atl03: Path, tracks: dict[str, Track]) -> Path:
    """ATL08 classes and heights that are the truth; noise is partly listed, partly not."""
    with h5py.File(atl03) as source, h5py.File(path, "w") as file:
        for beam, track in tracks.items():
            count = source[f"{beam}/geolocation/segment_ph_cnt"][()]
            first = np.repeat(np.cumsum(count) - count, count)
            segment = np.repeat(source[f"{beam}/geolocation/segment_id"][()], count)
            listed = (track.truth > 0) | (np.arange(len(track.truth)) % 10 == 0)
            group = file.create_group(f"{beam}/signal_photons")
            number = np.arange(len(track.truth)) - first + 1
            group["classed_pc_flag"] = track.truth[listed].astype(np.int8)
            group["classed_pc_indx"] = number[listed].astype(np.int32)
            group["ph_segment_id"] = segment[listed].astype(np.int32)
            time = np.repeat(source[f"{beam}/geolocation/delta_time"][()], count)
            group["delta_time"] = time[listed] + 0.001
            _write_land(file.create_group(f"{beam}/land_segments"), source[beam], track)
    return path


def _write_land(land: h5py.Group, photons: h5py.Group, track: Track) -> None:
    """Terrain of each segment of ATL03, five in a row; the middle one of a row is unknown."""
    number = photons["geolocation/segment_id"][()]
    first = np.arange(len(number) // 5) * 5
    middle = SEGMENT_M * (first[:, None] + np.arange(5)) + 10.0
    height = np.interp(middle, *track.reference_m.T)
    height[:, 2] = np.finfo(np.float32).max
    land["segment_id_beg"] = number[first]
    land["delta_time"] = photons["geolocation/delta_time"][()][first + 2]
    land["terrain/h_te_best_fit_20m"] = height.astype(np.float32)
    land["terrain/h_te_best_fit"] = np.interp(middle[:, 2], *track.reference_m.T)


def write_csv(path: Path, track: Track) -> Path:
    """A CSV with a column more than needed, in any order."""
    rows = zip(track.height_m, track.along_m, track.truth, strict=True)
    lines = [f"{z:.3f},{x:.3f},{t}" for z, x, t in rows]
    path.write_text("\n".join(["Height,Along_Track,truth", *lines]) + "\n")
    return path


def write_workflow(folder: Path, photons: str, **sections: Any) -> Path:
    """A workflow beside its files."""
    content = {"kind": "altimetry", "track": {"photons": photons}, "output": "out", **sections}
    path = folder / "workflow.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


def labels(output: Path, name: str) -> dict[str, NDArray[Any]]:
    """Columns of a delivered photon table."""
    table = pq.read_table(output / "photons" / f"{name}.parquet")
    return {column: table.column(column).to_numpy() for column in table.column_names}


def f1(kept: NDArray[np.bool_], signal: NDArray[np.bool_]) -> float:
    """Harmonic mean of precision and recall."""
    return float(2 * np.count_nonzero(kept & signal) / (kept.sum() + signal.sum()))
