"""Which points of an array are noise, and how much noise is expected where.

The filter asks for one thing that coordinates do not hold: the noise density around each point.
It is given, or follows from the beams as in a run, or is measured in the cloud's own empty space
(:mod:`~spl_batch.airborne.arrays.empty_space`); ``basis`` of the result names it.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spl_batch.airborne.arrays.checked import (
    box_of,
    coarse,
    points_of,
    require_shots,
    settings_of,
    values_of,
)
from spl_batch.airborne.arrays.compiling import with_notice
from spl_batch.airborne.arrays.empty_space import EmptySpace, empty_space
from spl_batch.airborne.arrays.labels import Basis, ExpectedNoise, Labels
from spl_batch.airborne.arrays.time_domain import Assessed, assess
from spl_batch.airborne.filter import denoise
from spl_batch.airborne.filter.expected_noise import NoiseInAir, look_at_air
from spl_batch.airborne.sensors.sensor import Sensor
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.errors import InputError, grouped
from spl_batch.lattice.tables import PointFlag, PointTable, canonical_order

CONTRADICTED: Final = 1.4
"""Times the expected noise that empty space may hold: afterpulses of noise make it 1.15."""

FEW: Final = 0.5
"""Share of the points around which the density is measured below which a user is warned."""


@with_notice
def filter_points(
    xyz: ArrayLike,
    noise_density: ArrayLike | None = None,
    *,
    gps_time: ArrayLike | None = None,
    channel: ArrayLike | None = None,
    beam_origin: ArrayLike | None = None,
    flightline: ArrayLike | None = None,
    return_number: ArrayLike | None = None,
    water: ArrayLike | None = None,
    sensor: str | Mapping[str, Any] | Sensor = "spl100",
    alpha: float | None = None,
    method: str | None = None,
    settings: Mapping[str, Any] | None = None,
) -> Labels:
    """Tell signal from background noise and afterpulses.

    With ``gps_time``, ``channel`` and ``beam_origin`` the labels are those of ``spl-batch run`` on
    the same points. With coordinates alone there are no shots, so no afterpulses are found, and the
    density of the noise is measured where the cloud is empty.

    Parameters
    ----------
    xyz : (n, 3) array_like
        Easting, northing, height in a projected CRS [m]. They are rounded to 1 mm.
    noise_density : float or (n,) array_like, optional
        Background noise around each point, where it is known [1/m3].
    gps_time : (n,) array_like, optional
        Times; equal ones are of one shot [s].
    channel : (n,) array_like, optional
        Beamlet number of each point, 0..255. Without it a shot is one beamlet.
    beam_origin : (n, 3) or (3,) array_like, optional
        Where the sensor was at each point's shot [m]; NaN leaves a point unassessed. Without it
        beams are found where lines of sight meet, or taken as vertical.
    flightline : (n,) array_like, optional
        Number of each point's flightline, 0..65535; one for all by default. A pause of a minute
        starts another.
    return_number : (n,) array_like, optional
        LAS return number; it orders equal points only.
    water : (n,) array_like of bool, optional
        Points over water, where a return below another one may be the bottom.
    sensor : str, mapping or Sensor
        The instrument: a preset's name, as ``spl100`` or ``hrqls``, or its facts.
    alpha : float, optional
        Share of pure noise that is kept; ``filter.alpha`` of a workflow, 0.001 by default.
    method : str, optional
        ``filter.method`` of a workflow; ``vsaes`` by default.
    settings : mapping, optional
        Sections of a workflow file: ``filter``, ``noise``, ``afterpulse``, ``acquisition``.

    Returns
    -------
    Labels

    Raises
    ------
    InputError
        If an array has a wrong shape, or holds no places, times or densities.
    WorkflowError
        If a setting is unknown or wrong.

    Notes
    -----
    The points are held in memory, about 400 bytes for each. For files, and for more than some ten
    million points, use ``spl-batch denoise`` or a workflow.

    Examples
    --------
    >>> import numpy as np, spl_batch
    >>> rng = np.random.default_rng(1)
    >>> ground = np.c_[rng.uniform(0, 50, (20_000, 2)), rng.normal(0, 0.03, 20_000)]
    >>> noise = rng.uniform([0, 0, -60], [50, 50, 60], (3_000, 3))
    >>> labels = spl_batch.filter_points(np.vstack([ground, noise]))
    >>> labels.basis
    'cloud'
    >>> bool(labels.signal[:20_000].mean() > 0.99 and labels.signal[20_000:].mean() < 0.03)
    True
    """
    chosen = settings_of(settings, sensor, filter={"alpha": alpha, "method": method})
    of_shots = {
        "gps_time": gps_time, "channel": channel, "beam_origin": beam_origin,
        "flightline": flightline, "return_number": return_number,
    }  # fmt: skip
    table, known = _looked_at(xyz, of_shots, chosen, water)
    given = None
    if noise_density is not None:
        given = values_of("noise_density", noise_density, len(table))
    labels = _filtered(table, given, known, chosen)
    return replace(labels, warnings=(*coarse(xyz), *labels.warnings))


@with_notice
def expected_noise(
    xyz: ArrayLike,
    *,
    gps_time: ArrayLike | None = None,
    channel: ArrayLike | None = None,
    beam_origin: ArrayLike | None = None,
    flightline: ArrayLike | None = None,
    at: ArrayLike | None = None,
    sensor: str | Mapping[str, Any] | Sensor = "spl100",
    settings: Mapping[str, Any] | None = None,
) -> ExpectedNoise:
    """Noise density that a cloud's beams, or its empty space, let expect.

    Parameters
    ----------
    xyz, gps_time, channel, beam_origin, flightline, sensor, settings
        As for :func:`filter_points`.
    at : (m, 3) array_like, optional
        Places that are asked for [m]; the points themselves by default. They need beams.

    Returns
    -------
    ExpectedNoise

    Raises
    ------
    InputError
        As for :func:`filter_points`, and where ``at`` is given without times.
    """
    chosen = settings_of(settings, sensor)
    of_shots = {
        "gps_time": gps_time, "channel": channel, "beam_origin": beam_origin,
        "flightline": flightline,
    }  # fmt: skip
    table, known = _looked_at(xyz, of_shots, chosen)
    if known is None:
        if at is not None:
            raise InputError(
                "at", "noise elsewhere needs beams; give gps_time, channel and beam_origin"
            )
        return _of_cloud(table)
    places = table if at is None else points_of(at)
    noise = NoiseInAir(known.model([places[axis] for axis in "xyz"], chosen))
    return ExpectedNoise(noise.local(places), noise.mean(places), known.basis, known.warnings)


def _looked_at(
    xyz: ArrayLike,
    of_shots: Mapping[str, ArrayLike | None],
    settings: Workflow,
    water: ArrayLike | None = None,
) -> tuple[PointTable, Assessed | None]:
    """Points in the caller's order with all that a canonical order needs, and their shots."""
    known = {name: values for name, values in of_shots.items() if values is not None}
    timed = "gps_time" in known
    for name in ("channel", "flightline", "beam_origin"):
        if name in known and not timed:
            raise InputError(name, "it is of shots, which times alone show; give gps_time as well")
    origin = known.pop("beam_origin", None)
    none = dict.fromkeys(("gps_time", "channel", "flightline", "return_number"), 0)
    table = points_of(xyz, water=water, **{**none, **known})
    count = len(table)
    table = table.with_columns(source=np.zeros(count, np.uint64), index=np.arange(count))
    if not timed or not count:
        return table, None
    require_shots(table["gps_time"])
    places = None if origin is None else values_of("beam_origin", origin, count)
    found = assess(table, places, settings)
    return found.table, found


def _filtered(
    table: PointTable,
    given: NDArray[np.float64] | None,
    known: Assessed | None,
    settings: Workflow,
) -> Labels:
    """Labels of points in the caller's order."""
    n = len(table)
    order, everything = canonical_order(table), np.ones(n, np.bool_)
    back = np.empty_like(order)
    back[order] = np.arange(n)
    ordered = table.take(order)
    basis: Basis = "given"
    warnings = () if known is None else known.warnings
    if given is not None:
        expected = mean = given[order]
    elif known is not None:
        noise = _expected(ordered, known, settings)
        expected, mean, basis = noise.local(ordered), noise.mean(ordered), known.basis
        space = empty_space(*(ordered[axis] for axis in "xyz"))
        warnings += _contradiction(space, expected)
    else:
        expected, mean, basis, warnings = _of_cloud(ordered)
    tested = mean if denoise.asks_for_means(settings.filter) else expected
    columns = denoise.denoise(
        ordered, expected, everything, settings.filter, settings.afterpulse, tested=tested
    )
    no_beam = int(np.count_nonzero(table.has(PointFlag.NO_BEAM)))
    if no_beam:
        text = f"{grouped(no_beam)} of {grouped(n)} points have no usable time or no beam_origin"
        warnings = (*warnings, f"{text}, and are not assessed")
    chance, spread = (
        table[name] if known is not None else np.zeros(n, np.float32)
        for name in ("afterpulse", "range_sigma")
    )
    return Labels(
        columns["noise_class"][back], columns["p_value"][back], mean[back].astype(np.float32),
        columns["wire"][back] == 1, chance, spread, basis, warnings,
    )  # fmt: skip


def _expected(places: PointTable, known: Assessed, settings: Workflow) -> NoiseInAir:
    """Noise by the beams and by what the air over points holds."""
    model = known.model([places[axis] for axis in "xyz"], settings)
    return NoiseInAir(model, look_at_air(places, model, settings, box_of(places)).air)


def _of_cloud(table: PointTable) -> ExpectedNoise:
    """Noise at points by the cloud's own empty space."""
    found = empty_space(*(table[axis] for axis in "xyz"))
    return ExpectedNoise(found.density, found.density, "cloud", _doubts(found, len(table)))


def _contradiction(found: EmptySpace, expected: NDArray[np.float64]) -> tuple[str, ...]:
    """What a caller should know where the cloud holds more noise than its beams let expect."""
    held = found.density > 0
    if not found.volume_m3 or found.share < FEW or not held.any():
        return ()
    times = float(np.median(found.density[held] / np.maximum(expected[held], 1e-12)))
    if times < CONTRADICTED:
        return ()
    text = f"the cloud's empty space holds {min(times, 99.9):.1f} times the noise that beams let"
    text += " expect, as in a clip of a survey, whose shots seem silent beyond it"
    return (f"{text}; more noise stays; filter whole flightlines, or leave out gps_time",)


def _doubts(found: EmptySpace, count: int) -> tuple[str, ...]:
    """What a caller should know of a density that the cloud itself shows."""
    if not count:
        return ()
    if not found.volume_m3:
        text = "the cloud holds no empty space in which noise can be counted, so none is expected"
        return (f"{text}; give noise_density, or gps_time and beam_origin",)
    if found.share < FEW:
        text = f"only {100 * found.share:.0f} % of the points lie where the cloud has empty space"
        return (f"{text} in which noise can be counted; the others take the nearest density",)
    return ()
