"""Space-domain noise filter: which points are background [W18 2.2.3; W17 5.2.2, 6.2.3].

Domain: space. Columns needed: x, y, z, flags, and those of
:mod:`~spl_batch.airborne.afterpulse.afterpulse_decision` where the time domain ran; columns added:
noise_class, p_value, wire.

Every method decides about the same points: those that the survey may use, without afterpulses,
which time domain and neighbourhood decide first. For our own tests a return that depends on another
one is no evidence either, and shares its label
(:mod:`~spl_batch.airborne.beams.dependent_returns`); the sources' filters count every return.
:data:`METHODS` names the module that judges.
"""

from collections.abc import Callable
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.afterpulse import afterpulse_decision
from spl_batch.airborne.beams.dependent_returns import LAG_M, follow
from spl_batch.airborne.beams.shot_runs import NO_BEAMLETS, Beamlets, beamlets_of
from spl_batch.airborne.filter import published
from spl_batch.airborne.filter.ellipsoid import ellipsoid_test
from spl_batch.airborne.filter.filter_interface import Cloud, Verdict, near_box
from spl_batch.airborne.filter.wires import wire_null, wire_scan
from spl_batch.airborne.settings import AfterpulseSettings, FilterSettings, NoiseSettings
from spl_batch.constants import NOISE_AFTERPULSE, NOISE_BACKGROUND, NOISE_NOT_ASSESSED, NOISE_SIGNAL
from spl_batch.lattice.tables import EXCLUDED, UNFILTERED, PointFlag, PointTable
from spl_batch.lattice.tiles import quanta

COLUMNS_NEEDED: Final = afterpulse_decision.COLUMNS_NEEDED
"""Columns of a table to filter."""

_JUDGED: Final = ("z", "flags")
"""Those that are looked at when it is known which returns are independent."""

_GIVEN: Final = PointFlag.WITHHELD | PointFlag.VENDOR_NOISE
"""What the vendor has judged is not judged again."""


class Method(NamedTuple):
    """How a filter judges, how far it looks [m], and whether it adds noise up over voxels."""

    judge: Callable[[Cloud, FilterSettings], Verdict]
    reach_m: Callable[[FilterSettings], float]
    by_voxel: bool = False


METHODS: Final = MappingProxyType(
    {
        "vsaes": Method(ellipsoid_test.judge, ellipsoid_test.reach_m),
        "aes": Method(published.aes, published.aes_reach_m, by_voxel=True),
        "dcc": Method(published.of_shots, lambda _: 0.0),
        "pixels": Method(published.of_shots, lambda _: 0.0),
        "voxel": Method(published.voxel, published.voxel_reach_m),
        "multilevel": Method(published.multilevel, published.multilevel_reach_m),
        "cylinder": Method(published.cylinder, published.cylinder_reach_m),
    }
)
"""The filters of the space domain by the name that ``filter.method`` has."""


NoiseColumns = dict[str, NDArray[Any]]
"""Columns that the filter gives for the query points, in table order."""


def reach_m(settings: FilterSettings) -> float:
    """Halo that the filter needs [m]."""
    if settings.method == "none":
        return 0.0
    reach = METHODS[settings.method].reach_m(settings)
    if _independent(settings):
        reach = max(reach, wire_scan.reach_m(settings.wires))
    return reach + afterpulse_decision.REACH_M + (LAG_M if _independent(settings) else 0.0)


def asks_for_means(settings: FilterSettings) -> bool:
    """Whether the filter adds up noise over whole voxels and needs their means, silence included.

    Others test a point in the noise of what is listened to around it.
    """
    return settings.method != "none" and METHODS[settings.method].by_voxel


def asks_for_air(settings: FilterSettings, noise: NoiseSettings) -> bool:
    """Whether haze is looked for: only by our own tests."""
    return noise.haze and _independent(settings)


def denoise(
    table: PointTable,
    density: NDArray[np.float64],
    query: NDArray[np.bool_],
    settings: FilterSettings,
    afterpulse: AfterpulseSettings = AfterpulseSettings(),  # noqa: B008 - frozen
    *,
    tested: NDArray[np.float64] | None = None,
) -> NoiseColumns:
    """Decide which points are noise.

    Columns and densities that a caller does not hold are freed as soon as they are used.

    Parameters
    ----------
    table : PointTable
        Points of a cell and its margin in canonical order, with :data:`COLUMNS_NEEDED`.
    density : (n,) float64
        Expected noise at each point [1/m3]; finite, >= 0. It must be right in the
        halo too, as far as links reach.
    query : (n,) bool
        Points to decide.
    afterpulse : AfterpulseSettings
        From which probability on an afterpulse is believed.
    tested : (n,) float64, optional
        The density that points are tested with where that is another one (:func:`asks_for_means`).

    Returns
    -------
    NoiseColumns
        Of the m query points: ``noise_class`` (m,) uint8; ``p_value`` (m,) float32, P(as much
        evidence | noise), NaN where not assessed; ``wire`` (m,) uint8, 1 for a sure conductor.
    """
    # Without a filter nothing asks for them.
    beamlets = NO_BEAMLETS if settings.method == "none" else beamlets_of(table)
    found = _resolve(table, density, settings, afterpulse, beamlets)
    density = density if tested is None else tested
    del tested
    table = table.select(("x", "y", *_JUDGED))
    rows, cloud = _alone(table, density, query, found, settings)
    del density
    table = table.select(_JUDGED)
    return _judge(table, rows, cloud, query, found, settings, beamlets)


def _alone(
    table: PointTable,
    density: NDArray[np.float64],
    query: NDArray[np.bool_],
    found: afterpulse_decision.Echoes,
    settings: FilterSettings,
) -> tuple[NDArray[np.int32], Cloud]:
    """Rows of the returns that are judged by themselves, and their cloud; none without a filter."""
    echo, dependent = found
    judged = ~table.has(EXCLUDED) & ~echo & ~dependent & (settings.method != "none")
    rows = np.flatnonzero(judged).astype(np.int32)
    # A parent outside the area of interest is judged for its followers.
    wanted = _with_parents(table, query & ~table.has(UNFILTERED), dependent)
    wanted &= ~table.has(EXCLUDED | PointFlag.NO_BEAM)
    return rows, _cloud(table, rows, density, wanted)


def _judge(
    table: PointTable,
    rows: NDArray[np.int32],
    cloud: Cloud,
    query: NDArray[np.bool_],
    found: afterpulse_decision.Echoes,
    settings: FilterSettings,
    beamlets: Beamlets,
) -> NoiseColumns:
    """Decide which points are noise, where it is known which are afterpulses."""
    echo, dependent = found
    excluded = table.has(EXCLUDED)
    noise_class = np.full(len(table), NOISE_NOT_ASSESSED, dtype=np.uint8)
    p_value = np.full(len(table), np.nan, dtype=np.float32)
    wire = np.zeros(len(table), dtype=np.uint8)
    if settings.method == "none":
        noise_class[~table.has(_GIVEN)] = NOISE_SIGNAL
    else:
        verdict, conductor = _verdict_on(cloud, settings)
        rows = rows[cloud.asked]
        wire[rows] = conductor
        signal = verdict.signal & ~cloud.shot_noise[cloud.asked]
        noise_class[rows] = np.where(signal, NOISE_SIGNAL, NOISE_BACKGROUND)
        p_value[rows] = verdict.p_value
        noise_class[echo] = NOISE_AFTERPULSE
        noise_class[dependent & ~table.has(EXCLUDED | PointFlag.NO_BEAM)] = NOISE_SIGNAL
        noise_class = follow(table, beamlets, ~excluded, dependent, noise_class)
        noise_class[table.has(UNFILTERED) & ~echo] = NOISE_NOT_ASSESSED
    noise_class[echo] = NOISE_AFTERPULSE
    outside = table.has(PointFlag.OUTSIDE_AOI)
    noise_class[outside] = NOISE_NOT_ASSESSED
    p_value[outside] = np.nan
    wire[noise_class != NOISE_SIGNAL] = 0
    return {"noise_class": noise_class[query], "p_value": p_value[query], "wire": wire[query]}


def _verdict_on(cloud: Cloud, settings: FilterSettings) -> tuple[Verdict, NDArray[np.bool_]]:
    """Verdict of the method, with what the scan for conductors keeps; (m,) bool, its sure ones.

    Test and scan share alpha, and p: a share x of pure noise has p <= x by either. So what the scan
    keeps of it is added to the p of the test, from the scan's own alpha on.
    """
    nothing = np.zeros(int(np.count_nonzero(cloud.asked)), np.bool_)
    if settings.method != "vsaes":
        return METHODS[settings.method].judge(cloud, settings), nothing
    if not (settings.wires.enabled and _independent(settings)):
        return ellipsoid_test.judge(cloud, settings), nothing

    def spent(density: NDArray[np.float64]) -> NDArray[np.float64]:
        return wire_null.spent(density, settings)

    verdict = ellipsoid_test.judge(cloud, settings, spent=spent)
    wires = wire_null.fitted(settings)
    found = wire_scan.scan(cloud, wires)
    both = (verdict.p_value + spent(cloud.density[cloud.asked])).astype(np.float32)
    both = np.where(both >= wires.alpha, np.minimum(both, 1.0), verdict.p_value)
    return Verdict(verdict.signal | found.signal, np.fmin(both, found.p_value)), found.wire


def _resolve(
    table: PointTable,
    density: NDArray[np.float64],
    settings: FilterSettings,
    afterpulse: AfterpulseSettings,
    beamlets: Beamlets,
) -> afterpulse_decision.Echoes:
    """Afterpulses, and returns that are no evidence of their own."""
    if settings.method == "none":
        return afterpulse_decision.believed(table)
    found = afterpulse_decision.resolve(table, density, afterpulse, beamlets)
    if _independent(settings):
        return found
    return afterpulse_decision.Echoes(found.echo, np.zeros(len(table), np.bool_))


def _with_parents(
    table: PointTable, query: NDArray[np.bool_], dependent: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Points to decide, and those that one of them may depend on: (n,) bool."""
    return query | near_box([table["x"], table["y"]], query & dependent, quanta(LAG_M))


def _independent(settings: FilterSettings) -> bool:
    """Whether dependent returns are left out of the evidence."""
    return settings.method == "vsaes" and settings.test != "published"


def _cloud(
    table: PointTable,
    rows: NDArray[np.int32],
    density: NDArray[np.float64],
    asked: NDArray[np.bool_],
) -> Cloud:
    """Rows of a table with coordinates relative to their smallest: exact in 32 bits."""
    xyz = np.empty((len(rows), 3), dtype=np.int32)
    anchor = [0, 0, 0]
    for axis, name in enumerate("xyz"):
        values = table[name][rows].astype(np.int64, copy=False)
        if len(values):
            anchor[axis] = int(values.min())
            xyz[:, axis] = values - anchor[axis]
    shot_noise = table.has(PointFlag.SHOT_NOISE)[rows]
    return Cloud(xyz, (anchor[0], anchor[1], anchor[2]), density[rows], asked[rows], shot_noise)
