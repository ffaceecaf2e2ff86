"""Whole trajectories in memory; a run reads the slices that it needs."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pyproj import CRS

from spl_batch.formats.gps_clock import TimeStandard
from spl_batch.formats.trajectory.positions import PointExtent, gathering
from spl_batch.lattice.tables import Trajectory


@dataclass(frozen=True, slots=True)
class LoadedTrajectory:
    """A trajectory and what was found out about it.

    Parameters
    ----------
    trajectory : Trajectory
        Sorted by time, in the survey's CRS.
    standard : str
        Time standard of its values.
    warnings : tuple of str
        What had to be done to it; each is one sentence.
    """

    trajectory: Trajectory
    standard: TimeStandard
    warnings: tuple[str, ...]


def read_trajectory(
    paths: Sequence[Path],
    *,
    survey_crs: CRS | None,
    trajectory_crs: str | None,
    points: PointExtent | None = None,
) -> LoadedTrajectory:
    """Trajectory files as one, all of it in memory.

    Parameters are those of :func:`spl_batch.formats.trajectory.positions.gathering`.
    """
    with gathering(
        paths, survey_crs=survey_crs, trajectory_crs=trajectory_crs, points=points
    ) as found:
        times, positions = zip(*found, strict=True)
    trajectory = Trajectory(np.concatenate(times), np.concatenate(positions))
    return LoadedTrajectory(trajectory, found.standard, found.warnings)
