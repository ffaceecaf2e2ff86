"""One row for each pair of flightlines that overlap: how far the second lies from the first.

A flightline that is shifted by ``(east, north, up)`` meets a plane of slope ``(p, q)`` higher by
``up - p east - q north``: flat patches give the vertical part, slopes the horizontal one. It is
found by least squares over the patches, weighted by their variance, with Huber's weights and then
Tukey's biweight. The noise of slopes would make a horizontal shift seem less than it is, so their
covariance is taken from the normal equations (W. A. Fuller, 1987, *Measurement Error Models*,
section 2.2). A horizontal part that is not determined is not reported.
"""

from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass
from scipy.special import ndtr, stdtrit

from spl_batch.airborne.lines.patches import Patches, rows_of
from spl_batch.airborne.settings.standards import ASKED
from spl_batch.airborne.store.flown_lines import LINES
from spl_batch.engine.report.parts import STRICT, Count, Measured, Number

FEWEST: Final = 10
"""Patches of a pair that show a difference, at least [count]."""

OWN_M: Final = 0.01
"""What a patch differs for reasons of its own beside noise [m]."""

BIWEIGHT: Final = 4.685
"""Tukey's constant [standard deviations]."""

HUBER: Final = 1.345
"""Huber's constant [standard deviations]."""

ROUNDS: Final = 10
"""Rounds of weights of each kind [count], Huber's first, which steep patches need before a shift is
known. They stand still after five or so."""

NEIGHBOURS_M: Final = 100.0
"""Patches in one square of this edge may differ for the same reason, as a turn of the aircraft or a
slope of the terrain, and count as one witness [m]."""

DETERMINED_M: Final = 0.1
"""Standard deviation of a horizontal difference, above which it is not reported [m]."""

FEW_M: Final = 0.2
"""Horizontal difference that is reported however few squares there are: on some few, aligned
flightlines have been seen to differ by half as much, sure as each square was [m]."""

TWICE: Final = 2.0
"""A patch thicker than this times the noise is overgrown, and no measure of heights."""

QUARTER: Final = 0.25
"""Share of the patches that are taken for smooth: the thickest of these is the ranging noise."""


@dataclass(frozen=True, kw_only=True, config=STRICT)
class StripPair:
    """Where a flightline lies against another that overlaps it, from planar patches of both."""

    first: str = Field(description="The flightline that is compared with.")
    second: str = Field(description="The one that is compared.")
    patches: Count = Field(description="Planar patches that both have [count].")
    area_m2: Measured = Field(description="Area of these patches [m2].")
    centre_m: tuple[Measured, Measured] = Field(
        description="Easting and northing of their middle [m]."
    )
    up_m: Measured = Field(description="The second above the first [m].")
    up_sd_m: Measured = Field(description="Standard deviation of it [m].")
    east_m: Number = Field(
        default=None, description="The second east of the first; null if flat [m]."
    )
    north_m: Number = Field(
        default=None, description="The second north of the first; null if flat [m]."
    )
    horizontal_sd_m: Number = Field(
        default=None, description="Standard deviation of these, in the worst direction [m]."
    )
    flat_patches: Count = Field(
        default=0, description="Smooth patches of up to 10 degrees [count]."
    )
    rmsd_z_m: Number = Field(
        default=None, description="Root mean square of the vertical differences of these [m]."
    )
    noise_m: Measured = Field(description="Ranging noise: spread about the smoothest patches [m].")
    squares: Count = Field(description="Squares of 100 m that hold the patches [count].")

    @property
    def is_off_vertically(self) -> bool:
        """Whether the flightlines differ by more than a single range does."""
        return abs(self.up_m) > max(self.noise_m, 3 * self.up_sd_m)

    @property
    def horizontal_m(self) -> float:
        """Length of the horizontal difference [m]; 0 where none is reported."""
        return float(np.hypot(self.east_m or 0.0, self.north_m or 0.0))

    @property
    def is_off_horizontally(self) -> bool:
        """The same for the horizontal difference; few squares show no small one."""
        if self.horizontal_sd_m is None:
            return False
        # Standard deviations that hold what three of a normal distribution hold.
        freedom = self.squares - 3  # east, north and up are found
        sure_sd = float(stdtrit(freedom, ndtr(3.0))) if freedom > 0 else np.inf
        sure = min(sure_sd * self.horizontal_sd_m, FEW_M)
        return self.horizontal_m > max(self.noise_m, 3 * self.horizontal_sd_m, sure)


def pair_table(patches: Patches, names: Mapping[int, str]) -> list[StripPair]:
    """Differences of all pairs of flightlines that share enough patches, by their names.

    ``patches``: of all ground cells; ``names``: of flightlines, by number.
    """
    pair = patches["first"] * LINES + patches["second"]
    order = np.argsort(pair, kind="stable")
    found = []
    for mine in np.split(order, np.flatnonzero(np.diff(pair[order])) + 1):
        if len(mine) < FEWEST:
            continue
        chosen = rows_of(patches, mine)
        first, second = (names[int(chosen[key][0])] for key in ("first", "second"))
        if first > second:
            first, second = second, first
            chosen["rise"] = -chosen["rise"]
        found.append(_difference(first, second, chosen))
    return sorted(found, key=lambda one: (one.first, one.second))


def _difference(first: str, second: str, patches: Patches) -> StripPair:
    noise = float(np.quantile(patches["thickness"], QUARTER))
    slope = np.hypot(patches["east"], patches["north"])
    flat = patches["rise"][(slope <= ASKED.flat) & (patches["thickness"] <= TWICE * noise)]
    area = patches["edge_m"] ** 2
    x_m, y_m = (float(np.average(patches[axis], weights=area)) for axis in "xy")
    return StripPair(
        first=first,
        second=second,
        patches=len(area),
        area_m2=float(area.sum()),
        centre_m=(x_m, y_m),
        **fit_shift(patches),
        flat_patches=len(flat),
        rmsd_z_m=float(np.sqrt(np.mean(flat**2))) if len(flat) else None,
        noise_m=noise,
        squares=int(_square(patches).max()) + 1,
    )


def fit_shift(patches: Patches) -> dict[str, float]:
    """Shift of the second flightline against the first, from at least one patch of both.

    Fields of a :class:`StripPair`, of which the horizontal ones are left out if nothing shows them.
    """
    rise, own = patches["rise"], patches["variance"] + OWN_M**2
    design = np.stack([-patches["east"], -patches["north"], np.ones(len(rise))], axis=1)
    noise = np.zeros((len(rise), 3, 3))
    noise[:, 0, 0], noise[:, 1, 1] = patches["ee"], patches["nn"]
    noise[:, 0, 1] = noise[:, 1, 0] = patches["en"]
    square = _square(patches)
    level = _robust(rise, design[:, 2:], own, noise[:, 2:, 2:], square)
    if level is None:  # one patch, or all alike: nothing to weigh
        return {"up_m": float(np.median(rise)), "up_sd_m": float(np.sqrt(own.min()))}
    vertical = {"up_m": float(level[0][0]), "up_sd_m": float(np.sqrt(level[1][0, 0]))}
    whole = _robust(rise, design, own, noise, square)
    if whole is None:
        return vertical
    found, covariance = whole
    worst = float(np.sqrt(max(np.linalg.eigvalsh(covariance[:2, :2])[-1], 0.0)))
    if worst > DETERMINED_M:
        return vertical
    shift = dict(zip(("east_m", "north_m", "up_m"), found.tolist(), strict=True))
    return {**shift, "up_sd_m": float(np.sqrt(covariance[2, 2])), "horizontal_sd_m": worst}


def _robust(
    rise: NDArray[np.float64],
    design: NDArray[np.float64],
    variance: NDArray[np.float64],
    noise: NDArray[np.float64],
    square: NDArray[np.intp],
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Unknowns by reweighted least squares, and their covariance; None if not determined."""
    found = np.zeros(design.shape[1])
    found[-1] = np.median(rise)
    for number in range(2 * ROUNDS):
        left = rise - design @ found
        # What the slopes' noise adds to the residual of a patch for the shift that was found.
        spread = np.sqrt(variance + np.einsum("i,pij,j->p", found, noise, found))
        ratio = left / spread
        scale = max(1.4826 * float(np.median(np.abs(ratio))), 1e-6)
        if number < ROUNDS:
            given = 1 / np.maximum(np.abs(ratio) / (HUBER * scale), 1.0)
        else:
            given = np.clip(1 - (ratio / (BIWEIGHT * scale)) ** 2, 0.0, None) ** 2
        weight = given / spread**2
        raw = np.einsum("p,pi,pj->ij", weight, design, design)
        normal = raw - np.einsum("p,pij->ij", weight, noise)
        if not _determines(normal, raw):
            return None
        found = np.linalg.solve(normal, design.T @ (weight * rise))
    # The sandwich: residuals as they are, not as their variances promise, by squares of place.
    scores = (weight * (rise - design @ found))[:, None] * design
    together = np.stack([np.bincount(square, column) for column in scores.T], axis=1)
    seen = len(together) / max(len(together) - 1, 1)
    inverse = np.linalg.inv(normal)
    covariances = [
        inverse @ (part.T @ part) @ inverse for part in (scores, np.sqrt(seen) * together)
    ]
    return found, max(covariances, key=lambda covariance: float(np.trace(covariance)))


def _square(patches: Patches) -> NDArray[np.intp]:
    """Which patches lie in the same square of :data:`NEIGHBOURS_M`, by number."""
    i, j = (np.floor(patches[axis] / NEIGHBOURS_M).astype(np.int64) for axis in "xy")
    _, number = np.unique(np.stack([i, j], axis=1), axis=0, return_inverse=True)
    return number.reshape(-1)


def _determines(normal: NDArray[np.float64], raw: NDArray[np.float64]) -> bool:
    """Whether slopes vary by more than their noise explains, in every direction."""
    if normal[-1, -1] <= 0:
        return False
    if len(normal) == 1:
        return True
    level = raw[:-1, -1:] @ raw[-1:, :-1] / raw[-1, -1]
    true = np.linalg.eigvalsh(normal[:-1, :-1] - level)
    seen = np.linalg.eigvalsh(raw[:-1, :-1] - level)
    return bool(true[0] > 0.5 * seen[0] > 0)
