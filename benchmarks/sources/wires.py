"""[W18] Tables 1-3, which are [W17] Tables 6-1 to 6-3: wires that filters find.

Misprints, with the counts of the source put right: distribution lines of Easton 60.0 % detected
(12,265 of 20,793 is 59.0 %); DCC's false alarm there 41.6 % (639 of 2944 is 21.7 %); AES detects
37.9 % of Lufkin's line (39,367 of 104,542 is 37.7 %).
"""

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from benchmarks.sources import corridors, methods
from benchmarks.sources.corridors import Counts, Span
from benchmarks.sources.given import Figures, Given
from benchmarks.sources.methods import WIRE, Columns
from benchmarks.sources.surfaces import reference_points

METHODS = ("published", "aes_alone", "dcc", "ours")
"""Filters of the tables; the source runs AES and DCC on each scan half of each flightline."""

PUBLISHED: Mapping[tuple[str, str], Mapping[str, Counts]] = {
    ("easton", "transmission"): {
        "published": Counts(57_185, 50_925, 0, 2884),
        "aes_alone": Counts(57_185, 14_802, 0, 799),
        "dcc": Counts(57_185, 7666, 0, 2016),
    },
    ("easton", "distribution"): {
        "published": Counts(20_793, 12_265, 0, 1042),
        "aes_alone": Counts(20_793, 6089, 0, 594),
        "dcc": Counts(20_793, 2305, 0, 639),
    },
    ("lufkin", "distribution"): {
        "published": Counts(104_542, 89_836, 0, 5250),
        "aes_alone": Counts(104_542, 39_367, 0, 2622),
        "dcc": Counts(104_542, 6370, 0, 980),
    },
}
"""Counts of the tables, by twin and kind of line, by method; how much noise the region had the
source does not give."""

STEP_M = 1.0
"""Length of wire that counts as one [m]."""

NEAR_M = 0.3
"""A return no farther from a strand than this is of it [m]."""


def measure(given: Given) -> Figures:
    """Detected and false alarms of each line and filter [%], and returns of wire for one of noise.

    Keys are ``TWIN.LINE.METHOD.found`` and ``.false``, ``TWIN.LINE.ratio``.
    """
    found: Figures = {}
    known = methods.known_methods()
    for name in given.some(("easton matched", "lufkin matched", "easton", "lufkin")):
        survey = given.survey(name)
        points = methods.load_truth(survey)
        lines = [(kind, corridors.region(s, points)) for kind, s in corridors.lines(survey)]
        for kind, within in lines:
            all_of = corridors.count(points, within, within)
            found[f"{name}.{kind}.ratio"] = all_of.wire / max(all_of.noise, 1)
        for key in METHODS:
            kept = methods.judge(survey, known[key]) == 0
            for kind, within in lines:
                counted = corridors.count(points, kept, within)
                found[f"{name}.{kind}.{key}.found"] = counted.detection
                found[f"{name}.{kind}.{key}.false"] = counted.false_alarm
    return found | dict(_linear_mode(given))


def _linear_mode(given: Given) -> Iterator[tuple[str, float]]:
    """[W17] Fig. 6-11: metres of each strand with a return, by either lidar [%]."""
    survey = given.survey("easton matched")
    points, reference = methods.load_truth(survey), reference_points(survey)
    kept = methods.judge(survey, methods.known_methods()["published"]) == 0
    extent = [(float(reference[a].min()), float(reference[a].max())) for a in "xy"]
    clouds: dict[str, Columns] = {
        "photons": {a: points[a][kept & (points["kind"] == WIRE)] for a in "xyz"},
        "linear": {a: reference[a] for a in "xyz"},
    }
    spans = next(s for kind, s in corridors.lines(survey) if kind == "distribution")
    for cloud, columns in clouds.items():
        for strand in range(len(spans[0].strands)):
            yield f"{cloud}.strand {strand}", _covered(spans, columns, strand, extent)


def _covered(
    spans: list[Span], columns: Columns, strand: int, extent: list[tuple[float, float]]
) -> float:
    """Metres of a strand within an extent that have a return [%]."""
    seen: list[NDArray[np.bool_]] = []
    for span in spans:
        alone = Span(span.start_m, span.along, span.length_m, span.strands[strand : strand + 1])
        near = corridors.distance_m(alone, columns) <= NEAR_M
        east, north = (columns[a][near] - o for a, o in zip("xy", span.start_m, strict=True))
        along = np.floor((east * span.along[0] + north * span.along[1]) / STEP_M).astype(int)
        held = np.zeros(int(span.length_m / STEP_M), dtype=np.bool_)
        held[along[along < len(held)]] = True
        middle = (np.arange(len(held)) + 0.5) * STEP_M
        there = [o + u * middle for o, u in zip(span.start_m, span.along, strict=True)]
        flown = [(v > low) & (v < high) for v, (low, high) in zip(there, extent, strict=True)]
        seen.append(held[flown[0] & flown[1]])
    return 100.0 * float(np.concatenate(seen).mean())
