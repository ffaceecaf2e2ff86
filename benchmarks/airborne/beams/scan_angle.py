"""Geometry of points and trajectory against the instrument's own scan angles.

``python -m benchmarks.airborne.beams.scan_angle POINTS TRAJECTORY`` joins each point with the
position at its time, takes the beam's angle across the flight direction, and prints its correlation
with the LAS scan angle.
"""

import sys
from pathlib import Path

import numpy as np

from benchmarks.airborne.beams.trajectories import read_trajectory
from spl_batch.constants import QUANTUM_M
from spl_batch.formats.las.reader import inspect, iter_points
from spl_batch.formats.trajectory.positions import PointExtent
from spl_batch.lattice.tables import SOURCE_COLUMNS, concat


def main(points: Path, trajectory: Path) -> float:
    """Print and return the correlation."""
    facts = inspect(points)
    table = concat(list(iter_points(points, channel_dimension=None, source=0)), SOURCE_COLUMNS)
    time = table["gps_time"]
    loaded = read_trajectory(
        [trajectory],
        survey_crs=facts.crs,
        trajectory_crs=None,
        points=PointExtent((float(time.min()), float(time.max())), (*facts.mins_m, *facts.maxs_m)),
    ).trajectory
    position, covered = loaded.position(time)
    later, ahead = loaded.position(time + 0.1)
    used = covered & ahead
    xyz = np.column_stack([table[axis] * QUANTUM_M for axis in "xyz"])
    beam, course = (xyz - position)[used], (later - position)[used]
    heading = np.arctan2(course[:, 0], course[:, 1])
    starboard = beam[:, 0] * np.cos(heading) - beam[:, 1] * np.sin(heading)
    angle = np.degrees(np.arctan2(starboard, -beam[:, 2]))
    r = float(np.corrcoef(angle, table["scan_angle"][used])[0, 1])
    print(f"{np.count_nonzero(used)} of {len(used)} points covered, r = {r:.5f}")
    return r


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("usage: python -m benchmarks.airborne.beams.scan_angle POINTS TRAJECTORY")
    main(Path(sys.argv[1]), Path(sys.argv[2]))
