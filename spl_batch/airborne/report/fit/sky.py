"""Where noise is not what its model says: haze and cloud, and noise that varies in the gate."""

from collections.abc import Iterator, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.context import Context
from spl_batch.airborne.filter.stray_returns import CELL_M
from spl_batch.airborne.noise.haze import CUBE_M
from spl_batch.airborne.products.air import near_ground
from spl_batch.airborne.products.product_table import is_piece
from spl_batch.airborne.report.fit.noise_fit import within
from spl_batch.airborne.report.model import Haze
from spl_batch.airborne.settings import FilterSettings
from spl_batch.airborne.strips.strip_comparison import pairs_of
from spl_batch.constants import NODATA, QUANTUM_M
from spl_batch.engine.report.number_format import as_ascii, significant
from spl_batch.engine.report.run_record import Receipts
from spl_batch.errors import counted, grouped
from spl_batch.formats.rasters.parts import overview_frame, read_overview

BAND: Final = 4
"""Layers of cubes that are told together: 20 m."""

TOLD: Final = 1.25
"""Times more, or less, noise than expected that is told; the model is within 1.03 in all strata
that were simulated."""

SURE: Final = 5.0
"""Standard deviations of the number of returns beyond which a difference is no chance."""

SHARE: Final = 0.15
"""Part of the noise that a difference must concern."""

FOG_LEAST_M2: Final = 2000.0
FOG_SHARE: Final = 0.5
"""Area from which fog is told [m2], and part of it that it fills."""

LEAST_M2: Final = 500.0
"""Area from which haze is told [m2]."""

THIN_PER_M3: Final = 0.2
"""Dense noise from which on a power line loses some of its returns [1/m3]."""


KEPT_TOLD: Final = 5.0
KEPT_LEAST: Final = 100
"""Times ``filter.alpha`` of the noise below all surfaces that is kept, from which on that is told,
and the returns that it takes [1, count]."""


class Band(NamedTuple):
    """Noise between two heights, over what is expected of it."""

    low_m: float
    high_m: float
    times: float


class Fog(NamedTuple):
    """Ground fog: how high it reaches, its part of a survey, and the survey's area."""

    high_m: float
    share: float
    area_m2: float


def haze(done: Receipts, context: Context) -> Haze | None:
    """Haze of the whole survey; None where there is none.

    Cubes around a clump of noise at the edge of a swath hold no more than the model expects.
    """
    parts = [r.facts["air"] for r in done.get("denoise", {}).values() if r.facts.get("air")]
    area = sum(part["squares"] for part in parts) * CUBE_M**2
    if area < LEAST_M2:
        return None
    returns = sum(part["returns"] for part in parts)
    expected = sum(part["expected"] for part in parts)
    if returns < TOLD * expected:
        return None
    volume = sum(part["cubes"] for part in parts) * CUBE_M**3
    box = np.array([part["box"] for part in parts]) * QUANTUM_M
    extent = (*box[:, :2].min(axis=0), *box[:, 2:].max(axis=0))
    low, high = (
        float(np.average([p[key] for p in parts], weights=[p["returns"] for p in parts]))
        for key in ("low", "high")
    )
    ground = _ground(context, (extent[0], extent[1], extent[2], extent[3]))
    return Haze(
        low_m=low * QUANTUM_M,
        high_m=high * QUANTUM_M,
        above_ground_m=None if ground is None else low * QUANTUM_M - ground,
        area_km2=area * 1e-6,
        extent_m=(float(extent[0]), float(extent[2]), float(extent[1]), float(extent[3])),
        returns=returns,
        mean_per_m3=returns / volume,
        times_expected=returns / expected if expected else None,
    )


def _ground(context: Context, bounds_m: tuple[float, float, float, float]) -> float | None:
    """Median height of the terrain below a place, of all pieces, in coarse cells if large [m]."""
    west, south, east, north = bounds_m
    known = np.empty(0, np.float32)
    for path in sorted(context.output.glob("dtm*.tif")):
        if not is_piece(path.stem, "dtm"):
            continue
        rows, cols, left, top, cell = overview_frame(path)
        if left < east and west < left + cols * cell and top - rows * cell < north and south < top:
            values = read_overview(path, bounds_m=bounds_m).values
            known = np.append(known, values[values > NODATA])
    return float(np.median(known)) if len(known) else None


def haze_warning(found: Haze | None) -> Iterator[str]:
    """Sentence that names haze, its place and its consequence."""
    if found is None or found.low_m is None or found.high_m is None or found.extent_m is None:
        return
    west, east, south, north = (f"{side:.0f}" for side in found.extent_m if side is not None)
    base, thick = found.above_ground_m, found.high_m - found.low_m
    means = "haze or cloud; its returns are class 18, and weak signals among them are lost"
    if base is None:
        where = f"between heights of {found.low_m:.0f} and {found.high_m:.0f} m"
    elif base + thick > 0.0:
        where = f"between {base:.0f} and {base + thick:.0f} m above ground"
    else:
        where = f"between {-base - thick:.0f} and {-base:.0f} m below ground"
        means = "no haze, for that lies above; its returns are class 7"
    times = "more than" if found.times_expected is None else f"{found.times_expected:.1f} times"
    yield as_ascii(
        f"noise {where} is {times} what the model of the noise expects, over "
        f"{significant(found.area_km2, 2)} km2 within x {west} to {east} and y {south} to {north}: "
        f"{means}"
    )


def bloom(done: Receipts) -> tuple[int, int]:
    """Shots that one bright point lit wholly, and their returns at its range [count]."""
    found = _bloom(done)
    return sum(one[0] for one in found), sum(one[1] for one in found)


def _bloom(done: Receipts) -> list[list[int]]:
    """Shots, returns, and west, south, east and north of these [quanta], by stretch."""
    return [r.facts["bloom"] for r in done.get("scatter", {}).values() if "bloom" in r.facts]


def crosstalk(done: Receipts) -> int:
    """Returns that one beside them in their shot may have set off [count]."""
    return sum(r.facts.get("crosstalk", 0) for r in done.get("scatter", {}).values())


def crosstalk_expected(done: Receipts) -> int:
    """How many returns others have set off, by the chance of it that flightlines show [count]."""
    facts = [r.facts for r in done.get("fit_line", {}).values()]
    found = [float(some["points"]) * float(some.get("crosstalk", 0.0)) for some in facts]
    return round(sum(found))


def bloom_warning(done: Receipts, *, removed: bool) -> Iterator[str]:
    """Sentence on shots in which a bright point lit the whole array."""
    shots, returns = bloom(done)
    if not shots:
        return
    fate = (
        "are noise, class 18 or 7"
        if removed
        else "stay signal and may raise the DSM: set noise.bloom: true to make them noise"
    )
    yield as_ascii(
        f"{counted(shots, 'shots')} {within([one[2:] for one in _bloom(done)])}: many channels "
        "have a return at one and the same range, and others behind it. Bright points such as "
        "retro-reflectors light the whole array so, or a small surface "
        f"that lets light pass; the {grouped(returns)} returns at that range {fate}"
    )


def fog_warning(done: Receipts) -> Iterator[str]:
    """Sentence on returns that fill the air just above the ground, everywhere or in patches.

    Not where flightlines lie so far apart, which is told: the upper one's ground fills it then.
    """
    found = _fog(done)
    low_m = near_ground.FLOOR_M if found is None else found.high_m - near_ground.STEP_M
    if low_m <= _apart_m(done):
        return
    if found is None:
        yield from _mist_warning(done)
        return
    yield as_ascii(
        f"returns fill the air up to {found.high_m:.1f} m above the ground evenly in "
        f"{100 * found.share:.0f} % of {significant(found.area_m2 * 1e-6, 2)} km2: ground fog, or "
        f"low plants without gaps. Up to there neither the DSM nor the signal points can be "
        "trusted"
    )


def _apart_m(done: Receipts) -> float:
    """Largest height between two flightlines that do not fit [m]."""
    pairs = [p for r in done.get("strip_pairs", {}).values() for p in pairs_of(r.facts)]
    return max((abs(pair.up_m) for pair in pairs if pair.is_off_vertically), default=0.0)


def _fog(done: Receipts) -> Fog | None:
    """Fog over most of the survey; None where there is none."""
    parts = [r.facts["filled"] for r in done.get("surface", {}).values() if r.facts.get("filled")]
    if not parts:
        return None
    places, *filled = np.array(parts).sum(axis=0)
    area_m2 = float(places * near_ground.SQUARE_M**2)
    shares = np.array(filled) / max(places, 1)
    if area_m2 < FOG_LEAST_M2 or shares[0] < FOG_SHARE:
        return None
    steps = int(np.argmax(np.append(shares < FOG_SHARE, True)))
    return Fog(near_ground.FLOOR_M + steps * near_ground.STEP_M, float(shares[0]), area_m2)


def _mist_warning(done: Receipts) -> Iterator[str]:
    """Sentence on patches of ground that returns fill, where most ground is clear."""
    found = [patch for r in done.get("surface", {}).values() for patch in r.facts.get("mist", ())]
    if not found:
        return
    _, x, y = max(found)
    top = near_ground.FLOOR_M + near_ground.LOW_STEPS * near_ground.STEP_M
    patches = f"{len(found)} patch{'es' * (len(found) > 1)}"
    yield as_ascii(
        f"returns fill the air up to {top:.1f} m and more above the ground evenly in {patches}, "
        f"{_extent(found, x, y)}: mist, or plants without gaps; there "
        "neither the DSM nor the signal points just above the ground can be trusted"
    )


def _extent(found: Sequence[Sequence[float]], x: float, y: float) -> str:
    """Area of all, and of the largest with its place; each begins with its number of places."""
    places = [patch[0] for patch in found]
    total, most = (near_ground.SQUARE_M**2 * n for n in (sum(places), max(places)))
    east, north = (grouped(round(axis * QUANTUM_M)) for axis in (x, y))
    return (
        f"{grouped(round(total))} m2 in all, the largest of {grouped(round(most))} m2 "
        f"at {east} E, {north} N"
    )


def thin_haze_warning(done: Receipts) -> Iterator[str]:
    """Sentence on layers of haze that are too thin to be taken for noise."""
    foggy = _fog(done) is not None
    found = [
        layer
        for r in done.get("surface", {}).values()
        for layer in r.facts.get("thin_haze", ())
        if not foggy or layer[-1] < FOG_SHARE
    ]
    if not found:
        return
    _, low, high, x, y, _ = max(found)
    yield as_ascii(
        f"returns fill the air evenly in {counted(len(found), 'thin layers')} above the ground, "
        f"{_extent(found, x, y)}, {low:.0f} to {high:.0f} m above it: "
        "haze or a low cloud, or crowns without a gap; as they are less than "
        f"{3 * CUBE_M:.0f} m thick they stay signal, and the DSM lies on them; look at the "
        "profile there, and classify by hand what is no canopy"
    )


def drowned_warning(done: Receipts) -> Iterator[str]:
    """Sentence on dense noise that leaves no surface, or takes what is thin."""
    parts = [r.facts for r in done.get("ground", {}).values() if r.facts.get("dense")]
    if not parts:
        return
    dense, drowned, sums = np.array([facts["dense"] for facts in parts]).sum(axis=0).tolist()
    area_m2 = drowned * CELL_M**2
    where = (
        f"noise is dense, {significant(sums / dense, 2)} returns per m3 over "
        f"{significant(dense * CELL_M**2 * 1e-6, 2)} km2"
    )
    if area_m2 < LEAST_M2:
        if dense * CELL_M**2 >= LEAST_M2 and sums >= THIN_PER_M3 * dense:
            yield as_ascii(f"{where}: wires and other thin objects lose returns in it")
        return
    boxes = np.array([facts["core"] for facts in parts if facts["dense"][1]]) * QUANTUM_M
    west, south = boxes[:, :2].min(axis=0).tolist()
    east, north = boxes[:, 2:].max(axis=0).tolist()
    yield as_ascii(
        f"{where}, and in {grouped(round(area_m2))} m2 of "
        f"it, within x {west:.0f} to {east:.0f} and y {south:.0f} to {north:.0f}, no surface "
        "stands out: no ground is found there, and the terrain is void or spans it from the sides"
    )


def kept_warning(done: Receipts, settings: FilterSettings) -> Iterator[str]:
    """Sentence on more noise that is kept where nothing stands than the filter promises."""
    if settings.method != "vsaes" or settings.test != "calibrated":
        return
    found = [r.facts.get("below", [0, 0]) for r in done.get("ground", {}).values()]
    kept, refused = (sum(counts[k] for counts in found) for k in (0, 1))
    share = kept / max(kept + refused, 1)
    if kept >= KEPT_LEAST and share > KEPT_TOLD * settings.alpha:
        yield as_ascii(
            f"below all surfaces, where only noise lies, {significant(100 * share, 2)} % of "
            f"{grouped(kept + refused)} returns were kept in place of the "
            f"{significant(100 * settings.alpha, 2)} % of filter.alpha: the noise comes in "
            "clusters that its model does not know. About that share of the noise above surfaces "
            "stays among the signal, too"
        )


def misfit_warning(done: Receipts, context: Context) -> Iterator[str]:
    """Sentence on heights in which noise alone is more, or less, than expected."""
    bands = _bands([r.facts.get("layers", []) for r in done.get("denoise", {}).values()])
    if not bands:
        return
    boxes = [r.facts["bounds"] for r in done["index_file"].values() if r.facts["bounds"]]
    low = [min(box[axis] for box in boxes) * QUANTUM_M for axis in (0, 1)]
    high = [max(box[axis] for box in boxes) * QUANTUM_M for axis in (3, 4)]
    ground = _ground(context, (low[0], low[1], high[0], high[1]))
    base, of = (0.0, "in height") if ground is None else (ground, "above the mean ground")
    listed = ", ".join(
        f"{_times(band.times)} times between {round(band.low_m - base)} and "
        f"{round(band.high_m - base)} m"  # whole numbers know no -0
        for band in bands
    )
    hint = ""
    if context.workflow.survey.channel_dimension is None:
        hint = "; if this is linear-mode lidar, which has no such noise, set filter.method: none"
    yield as_ascii(
        f"away from all surfaces the noise is not what its model expects: {listed} {of}. The "
        "noise changes along the gate. Where there is more of it, the filter keeps more than "
        f"filter.alpha says; where there is less, weak signals are lost{hint}"
    )


def _times(ratio: float) -> str:
    """A ratio; one over next to nothing is only large."""
    return f"{ratio:.2f}" if ratio < LARGE else f"more than {LARGE:.0f}"


LARGE: Final = 100.0
"""Ratios from here on are told as no number: hardly any noise was expected."""


def _bands(parts: list[list[list[Any]]]) -> list[Band]:
    """Heights in which noise differs from what is expected, joined where they touch."""
    rows = np.array([row for part in parts for row in part], dtype=np.float64).reshape(-1, 3)
    if not len(rows):
        return []
    band, at = np.unique(np.floor(rows[:, 0] / BAND), return_inverse=True)
    seen, expected = (np.bincount(at, rows[:, k]).astype(np.float64) for k in (1, 2))
    differs = _differs(seen, expected)
    more = seen > expected
    if expected[differs].sum() < SHARE * expected.sum():
        return []
    found: list[Band] = []
    edge = BAND * CUBE_M
    start = 0
    for k in range(len(band)):
        last = k + 1 == len(band)
        if last or band[k + 1] != band[k] + 1 or (differs[k + 1], more[k + 1]) != (
            differs[k], more[k],
        ):  # fmt: skip
            if differs[k]:
                run = slice(start, k + 1)
                times = seen[run].sum() / expected[run].sum()
                found.append(Band(band[start] * edge, (band[k] + 1) * edge, float(times)))
            start = k + 1
    return found


def _differs(seen: NDArray[np.float64], expected: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether noise differs from what is expected by more than chance and more than is told."""
    sure = np.abs(seen - expected) > SURE * np.sqrt(np.maximum(expected, 1.0))
    large: NDArray[np.bool_] = (seen > TOLD * expected) | (seen < expected / TOLD)
    return sure & large
