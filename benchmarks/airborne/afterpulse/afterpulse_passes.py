"""What beamlets that pass a place on their way down tell about leaves there, beyond the filter.

``python -m benchmarks.airborne.afterpulse.afterpulse_passes [FOLDER]`` uses canopies of
:mod:`benchmarks.airborne.afterpulse.afterpulses`,
and simulates into FOLDER (a temporary one by default) those that it lacks.

A return far down says that its beamlet's light came through everything above it. Around each
follower in vegetation, in spheres, are the length of such ways, of all flightlines, and the returns
of other beamlets. Their ratio is how dense leaves are, whatever the light that reached them. A
logistic law takes these beside the filter's own probability; it is fitted to the truth of one
canopy and tried on others. What it removes at 2 % of vegetation lost is more than what any rule
made of the same numbers by hand would.
"""

import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.spatial import cKDTree

from benchmarks.airborne.afterpulse.afterpulse_scenes import CANOPIES, LIGHTS
from benchmarks.airborne.afterpulse.afterpulse_tables import Prepared, prepare
from benchmarks.airborne.afterpulse.afterpulses import (
    LOST_MAX,
    leaves_and_echoes,
    removed_at,
    scores,
)
from spl_batch.airborne.afterpulse import afterpulse_decision
from spl_batch.airborne.beams import geometry
from spl_batch.airborne.beams.shot_runs import run_starts
from spl_batch.constants import QUANTUM_M
from spl_batch.lattice.tables import Trajectory

FITTED = "clumps of leaves"
TRIED = ("clumps, 1 of the light", "round clumps, 1 of the light", "clumps, one flightline")
RADII_M = (0.25, 0.4, 0.7, 1.2)
WAY_M = 15.0
"""How far above its last return a beamlet's way is followed [m]."""

STEP_M = 0.2
"""Points along ways [m]."""

PENALTY = 1e-4
"""Of the squares of the law's weights."""


def main(folder: Path) -> None:
    """Print what is removed by each set of numbers."""
    by_name = {content["name"]: content for content in (*CANOPIES, *LIGHTS)}
    seen = {name: _look(name, by_name, folder) for name in (FITTED, *TRIED)}
    print(f"Afterpulses of vegetation removed [%] at {100 * LOST_MAX:g} % lost; {FITTED}: fitted")
    print(f"{'':34s}" + "".join(f"{name[:22]:>24s}" for name in seen))
    sets = {"the filter's probability": "p", "and ways": "pw", "and returns": "pr",
            "and returns per way": "pd", "and all of these": "pwrd"}  # fmt: skip
    for title, kinds in sets.items():
        law = _fit(seen[FITTED], kinds)
        print(f"{title:34s}" + "".join(f"{_removed(s, law, kinds):24.1f}" for s in seen.values()),
              flush=True)  # fmt: skip


class _Seen:
    """Followers of a canopy, with what is around them."""

    def __init__(self, survey: Prepared, folder: Path) -> None:
        self.survey, self.score = survey, scores(survey)
        chances = afterpulse_decision.probability(survey.table, survey.density)
        soft = ~chances.hard
        self.rows, chance = chances.rows[soft], chances.chance[soft].clip(1e-9, 1 - 1e-9)
        table = survey.table
        xyz = np.stack([table[axis] for axis in "xyz"], axis=1) * QUANTUM_M
        returns, ways = cKDTree(xyz), cKDTree(_ways(survey, xyz, folder))
        at = xyz[self.rows]
        count = np.stack([returns.query_ball_point(at, r, return_length=True) for r in RADII_M], 1)
        length = np.stack([ways.query_ball_point(at, r, return_length=True) for r in RADII_M], 1)
        length = length * STEP_M
        self.features = {
            "p": np.log(chance / (1 - chance))[:, None],
            "w": np.log(length + 0.2),
            "r": np.log(count),
            "d": np.log(count / (length + 0.5)),
        }

    def matrix(self, kinds: str) -> NDArray[np.float64]:
        """Columns of some kinds, the first one being 1."""
        columns = [np.ones((len(self.rows), 1)), *(self.features[kind] for kind in kinds)]
        return np.concatenate(columns, axis=1)


def _look(name: str, by_name: dict[str, dict[str, Any]], folder: Path) -> _Seen:
    place = folder / name.replace(" ", "_")
    return _Seen(prepare(by_name[name], place), place)


def _ways(survey: Prepared, xyz: NDArray[np.float64], folder: Path) -> NDArray[np.float64]:
    """Points along the ways of beamlets above their last returns: (k, 3) float64 [m]."""
    record = np.loadtxt(folder / "trajectory.csv", delimiter=",", skiprows=1)
    beams = geometry.beams(survey.table, Trajectory(record[:, 0], record[:, 1:4]))
    time, channel = survey.table["gps_time"], survey.table["channel"]
    order = np.lexsort((beams.range_m, channel, time))
    last = order[run_starts(time[order], channel[order])[1:] - 1]
    up = np.arange(STEP_M, WAY_M, STEP_M)
    way: NDArray[np.float64] = xyz[last, None] - up[:, None] * beams.direction[last, None]
    return way.reshape(-1, 3)


def _fit(seen: _Seen, kinds: str) -> NDArray[np.float64]:
    """Weights of a logistic law for the followers of vegetation."""
    true, false = (mask[seen.rows] for mask in leaves_and_echoes(seen.survey))
    x, y = seen.matrix(kinds)[true | false], false[true | false]

    def loss(weights: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        logit = x @ weights
        miss = 1.0 / (1.0 + np.exp(-logit)) - y
        value = np.mean(np.logaddexp(0.0, logit) - y * logit) + PENALTY * weights @ weights
        return float(value), x.T @ miss / len(y) + 2 * PENALTY * weights

    return minimize(loss, np.zeros(x.shape[1]), jac=True, method="L-BFGS-B").x


def _removed(seen: _Seen, law: NDArray[np.float64], kinds: str) -> float:
    score = seen.score.copy()
    score[seen.rows] = 1.0 / (1.0 + np.exp(-seen.matrix(kinds) @ law))
    return removed_at(score, *leaves_and_echoes(seen.survey), LOST_MAX)


if __name__ == "__main__":
    if len(sys.argv) > 1:
        main(Path(sys.argv[1]))
    else:
        with tempfile.TemporaryDirectory() as temporary:
            main(Path(temporary))
