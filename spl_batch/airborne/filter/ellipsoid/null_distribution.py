"""Null distribution of the adaptive-ellipsoid test: what pure noise scores, drawn once.

Domain: space. An ellipsoid is fitted to the points that it counts, so under the null its count is
not Poisson, as [W18 Eq. 6-8] take it. The difference depends only on the noise density and the
test's settings. So the code that scores surveys scores uniform noise in periodic boxes of 1e-4 to
10 per m3, and tabulates by density:

==================== ===================================================================
``NullTable.score``  the score that a share p of pure noise does not exceed
``NullTable.link_m`` how near the ``link_count``-th strong peer of a weak point of pure noise
                     comes for a share ``link_share`` x alpha of all points, or ``link_m``
``NullTable.own``    the rest of alpha
==================== ===================================================================

The table of the default settings ships (``null_table.json``, written by ``python -m
benchmarks.airborne.filter.null_table``); others draw a coarser one on first use, in each process.
Interpolation is linear in logarithms; beyond the last level p falls with the score as on average
over the last decade. Accuracy: ``python -m benchmarks.held --only alpha``.
"""

import json
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from importlib.resources.abc import Traversable
from typing import Any, Final, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.filter.ellipsoid.ellipsoid_counts import evidence
from spl_batch.airborne.filter.ellipsoid.quantile_table import between, level_of, value_of
from spl_batch.airborne.filter.ellipsoid.spacing import peer_distances
from spl_batch.airborne.settings import FilterSettings
from spl_batch.constants import QUANTUM_M
from spl_batch.engine.settings.base import Section
from spl_batch.lattice.tiles import quanta
from spl_batch.numerics.neighbours.kdtree import build

FILE: Final = "null_table.json"

IRRELEVANT: Final = frozenset(
    {
        "method",
        "test",
        "alpha",
        "wires",
        "aes",
        "dcc",
        "pixels",
        "voxel",
        "multilevel",
        "cylinder",
    }
)
"""Settings that the null distribution does not depend on. Any other setting is part of a table's
key: a new one draws its own table and cannot be overlooked."""

DENSITIES: Final = 10.0 ** np.linspace(-4, 1, 51)
"""Noise densities of the table [1/m3]."""

LEVELS: Final = 10.0 ** -np.linspace(0, 4.5, 46)
"""Shares of pure noise, from all to 3e-5."""

ALPHAS: Final = 10.0 ** -np.linspace(1, 4, 13)
"""Levels that links are tabulated for."""

POINTS: Final = 100_000
"""Noise points drawn per density where no shipped table fits [count]."""

SMOOTH: Final = 5
"""Neighbouring densities that smooth each other's drawn quantiles."""

ROUNDS: Final = 3
"""Times that the share of links is balanced with that of the points that pass alone."""

TOLD_TO: Final = 1e-6
"""Score down to which the calibrated test counts on beyond its decision: at any density below that
of the last of :data:`LEVELS`."""

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class NullTable:
    """Null distribution for fixed settings; logarithms are natural."""

    density: NDArray[np.float64]  #: (d,): log noise density [1/m3], ascending.
    level: NDArray[np.float64]  #: (p,): log share of pure noise, descending from 0.
    #: (d, p): log score that this share does not exceed, descending along each row.
    score: NDArray[np.float64]
    alpha: NDArray[np.float64]  #: (a,): log level of the whole decision, descending.
    #: (d, a): log share of noise that may pass alone, so that alpha pass with links.
    own: NDArray[np.float64]
    link_m: NDArray[np.float64]  #: (d, a): log of the longest link [m].

    def critical(
        self, density: NDArray[np.float64], share: float | NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Score that a share of noise of these densities does not exceed: (n,)."""
        wanted = np.log(np.broadcast_to(share, density.shape))
        return np.exp(value_of(self._row(density), wanted, self.score, self.level, self._slope()))

    def p_value(
        self, density: NDArray[np.float64], score: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Share of noise of these densities that scores no more: (n,), 0 without noise."""
        log_score = np.log(np.maximum(score, np.finfo(np.float64).tiny))
        log_p = level_of(self._row(density), log_score, self.score, self.level, self._slope())
        return np.where(density > 0, np.exp(log_p), 0.0)

    def alone(
        self, density: NDArray[np.float64], alpha: float | NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Share of noise that may pass alone at level ``alpha``: (n,)."""
        return self._by_alpha(density, alpha, self.own - self.alpha) * alpha

    def link(
        self, density: NDArray[np.float64], alpha: float | NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Longest link at level ``alpha``: (n,) [m]."""
        return self._by_alpha(density, alpha, self.link_m)

    def _by_alpha(
        self,
        density: NDArray[np.float64],
        alpha: float | NDArray[np.float64],
        table: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Exponential of a table's value, linear between its rows and columns: (n,)."""
        row = self._row(density)
        wanted = -np.log(np.broadcast_to(alpha, density.shape))
        column = np.interp(wanted, -self.alpha, np.arange(len(self.alpha)))
        found: NDArray[np.float64] = np.exp(between(row, column, table))
        return found

    def _row(self, density: NDArray[np.float64]) -> NDArray[np.float64]:
        """Row of the table, with its fraction; its ends beyond them."""
        log_density = np.log(np.maximum(density, np.finfo(np.float64).tiny))
        return np.interp(log_density, self.density, np.arange(len(self.density)))

    def _slope(self) -> float:
        """Change of log p with log score over the last decade of the table, mean over densities."""
        first = int(np.searchsorted(-self.level, -self.level[-1] - np.log(10.0)))
        rise = self.score[:, first] - self.score[:, -1]
        return float(np.mean((self.level[first] - self.level[-1]) / rise))


def settings_key(settings: Section, irrelevant: frozenset[str]) -> dict[str, Any]:
    """Settings, of the filter or a part of it, that a drawn table belongs to: all that matter."""
    return settings.model_dump(mode="json", exclude=set(irrelevant))


def shipped_or_drawn(
    file: Traversable,
    irrelevant: frozenset[str],
    parse: Callable[[Mapping[str, Any]], T],
    draw: Callable[[Mapping[str, Any], T], T],
) -> Callable[[Section], T]:
    """Function that gives a table: the shipped one, or one that is drawn now and kept in memory.

    ``irrelevant``: settings that it does not depend on; ``draw``: table of other settings, given
    these and the shipped one.
    """
    lock = threading.Lock()

    @lru_cache(maxsize=8)
    def table(key: str) -> T:
        content = json.loads(file.read_text("utf-8"))
        shipped, own = parse(content), json.loads(key)
        return shipped if content["settings"] == own else draw(own, shipped)

    def of(settings: Section) -> T:
        with lock:
            return table(json.dumps(settings_key(settings, irrelevant), sort_keys=True))

    return of


def parse_table(content: Mapping[str, Any]) -> NullTable:
    """Table of a JSON file's content."""
    names = ("density", "level", "score", "alpha", "own", "link_m")
    return NullTable(*(np.array(content[name], dtype=np.float64) for name in names))


def draw_table(
    settings: FilterSettings,
    points: int | NDArray[np.int64],
    densities: NDArray[np.float64] = DENSITIES,
) -> NullTable:
    """Draw the null distribution.

    Parameters
    ----------
    settings : FilterSettings
        All matter but :data:`IRRELEVANT`.
    points : int or (d,) int64
        Noise points per density [count].
    densities : (d,) float64
        [1/m3], evenly spaced in logarithm.
    """
    settings = settings.model_copy(update={"test": "calibrated"})
    numbers = np.broadcast_to(points, densities.shape).tolist()
    wanted = enumerate(zip(densities.tolist(), numbers, strict=True))
    drawn = [_drawn(settings, i, density, number) for i, (density, number) in wanted]
    own, link = np.moveaxis(np.log(np.array([d.links for d in drawn])), 2, 0)
    smooth = _smooth(np.array([d.score for d in drawn]))
    return NullTable(
        np.log(densities),
        np.log(LEVELS),
        np.minimum.accumulate(np.minimum(smooth, 0.0), axis=1),
        np.log(ALPHAS),
        np.minimum(_smooth(own), np.log(ALPHAS)),
        np.minimum(_smooth(link), np.log(max(settings.link_m, QUANTUM_M))),
    )


null_table = shipped_or_drawn(
    resources.files(__package__) / FILE,
    IRRELEVANT,
    parse_table,
    lambda own, _: draw_table(FilterSettings(test="calibrated", **own), POINTS, DENSITIES[::2]),
)
"""Table of a filter's settings."""


class _Drawn(NamedTuple):
    """One density: log score by level, and links by alpha."""

    score: NDArray[np.float64]
    links: list["_Links"]


def _drawn(settings: FilterSettings, seed: int, density: float, points: int) -> _Drawn:
    rng = np.random.default_rng([seed, points])
    xyz, source, core = periodic_noise(rng, density, points, settings)
    found = evidence(xyz, np.full(len(xyz), density), core, settings, TOLD_TO)
    ordered = np.sort(found.score[core])
    noise = _Noise(xyz, core, found.score[source], found.tree.by_row(found.spacing)[source])
    links = [_links(noise, ordered, alpha, settings) for alpha in ALPHAS]
    return _Drawn(np.log(np.quantile(ordered, LEVELS, method="inverted_cdf")), links)


def _smooth(drawn: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rows smoothed by a parabola through each and its neighbours."""
    from scipy.signal import savgol_filter  # noqa: PLC0415 - drags scipy.stats in, 1 s

    smooth: NDArray[np.float64] = savgol_filter(drawn, SMOOTH, 2, axis=0)
    return smooth


def periodic_noise(
    rng: np.random.Generator, density: float, points: int, settings: FilterSettings
) -> tuple[NDArray[np.int32], NDArray[np.intp], NDArray[np.bool_]]:
    """Uniform noise in a box that repeats itself, as far as the test looks; see :func:`repeated`.

    The box holds ``points`` on average and is no narrower than the test's reach.
    """
    around = max(settings.neighbour_cap_m, settings.axis_cap_m + settings.spacing_cap_m)
    around = quanta(max(around, settings.link_m))
    side = max(quanta((points / density) ** (1.0 / 3.0)), around)
    return repeated(rng, density, np.full(3, side), np.full(3, around))


def repeated(
    rng: np.random.Generator,
    density: float,
    size: NDArray[np.int64],
    around: NDArray[np.int64],
) -> tuple[NDArray[np.int32], NDArray[np.intp], NDArray[np.bool_]]:
    """Uniform noise [1/m3] in a box of any size, and its images ``around`` it [quanta].

    Points (n, 3) of the box, then the images; the row of each in the box; which are no images.
    """
    number = rng.poisson(density * float(np.prod(size / quanta(1.0))))
    xyz = rng.integers(0, size, (number, 3))
    source = np.arange(number)
    for axis in range(3):
        low, high = xyz[:, axis] < around[axis], xyz[:, axis] >= size[axis] - around[axis]
        shift = size[axis] * (np.arange(3) == axis)
        xyz = np.concatenate([xyz, xyz[low] + shift, xyz[high] - shift])
        source = np.concatenate([source, source[low], source[high]])
    return (xyz + around).astype(np.int32), source, np.arange(len(xyz)) < number


class _Links(NamedTuple):
    """Share of noise that passes alone, and the longest link of the rest [m]."""

    own: float
    link_m: float


class _Noise(NamedTuple):
    """Points of a box and their images: which are no image, and what each scores."""

    xyz: NDArray[np.int32]
    core: NDArray[np.bool_]
    score: NDArray[np.float64]
    spacing: NDArray[np.float64]


def _links(
    noise: _Noise,
    ordered: NDArray[np.float64],
    alpha: float,
    settings: FilterSettings,
) -> _Links:
    """How alpha is shared between points that pass alone and linked ones.

    Links get ``link_share`` of it, or what they use if that is less. Fewer strong points make fewer
    links, so the rest is found in two rounds.
    """
    if settings.link_count == 0:
        return _Links(alpha, max(settings.link_m, QUANTUM_M))
    number = len(ordered)
    weakest = _at(ordered, settings.weak_alpha)
    own = alpha * (1.0 - settings.link_share)
    link = settings.link_m
    for _ in range(ROUNDS):
        critical = _at(ordered, own)
        strong = noise.score <= critical
        weak = noise.core & ~strong & (noise.score <= weakest)
        tree = build(noise.xyz[strong])
        distance = np.sort(
            peer_distances(
                tree, tree.by_slot(noise.spacing[strong]), noise.xyz[weak], noise.spacing[weak],
                quanta(settings.link_m), settings.link_count, settings.peer_ratio,
            )
        )  # fmt: skip
        wanted = round((alpha - own) * number)
        linked = min(wanted, int(np.isfinite(distance).sum()))
        link = settings.link_m
        if linked == wanted and wanted > 0:
            link = min(float(distance[wanted - 1]) / quanta(1.0), link)
        own = alpha - linked / number
    return _Links(max(own, alpha * (1.0 - settings.link_share)), max(link, QUANTUM_M))


def _at(ordered: NDArray[np.float64], share: float) -> float:
    """Score that a share of the points does not exceed."""
    return float(ordered[max(round(share * len(ordered)) - 1, 0)])
