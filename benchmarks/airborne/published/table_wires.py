"""[W18] Tables 1-3 on the twins of Easton and Lufkin.

Misprints, with the counts of the source put right: distribution lines of Easton 60.0 % detected
(12,265 of 20,793 is 59.0 %); DCC's false alarm there 41.6 % (639 of 2944 is 21.7 %); AES detects
37.9 % of Lufkin's line (39,367 of 104,542 is 37.7 %).

Beside the source's two figures stand those that explain where ours differ:

- "by eye": false alarms farther than half a metre from every wire that are no afterpulses. A human
  who sorts returns by eye puts what lies on a wire to the wire.
- "noise kept": share of all the survey's background that the filter keeps.
- "> 1.5 m": share of the region's noise farther from every wire that is kept. A sphere of AES ends
  there, an ellipsoid does not.
- "bright": the twin with wires of four times the diameter. As the link budget has it, the twins'
  regions hold more noise than wire (last columns), part of it afterpulses of the wires.
- "merged" against "lines alone": AES and VSAES each on all flightlines and on each by itself. What
  sets VSAES apart in the source, where AES runs on single flightlines, is the merging.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.airborne.published import corridors, methods
from benchmarks.airborne.published.corridors import Counts
from benchmarks.airborne.published.methods import BACKGROUND, Method
from benchmarks.airborne.published.twins import TWINS

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
"""Counts of [W18] Tables 1-3, by twin and kind of line, by method; how much noise the region held
it does not say, and stands as none."""

BRIGHTER = {"easton": "bright", "lufkin": "lufkin bright"}
"""Twin of bright wires by twin."""

BRIGHT = ("published", "published_alone", "aes_alone", "dcc", "ours")
"""Methods that are run on the twins of bright wires."""

CLOSE_M = 0.5
"""Noise nearer to a wire than this is classed with it by eye [m]."""

SPHERE_M = 1.5
"""Radius of the sources' spheres [m]."""

TITLES = {
    ("easton", "transmission"): "Table 1, Easton, transmission line",
    ("easton", "distribution"): "Table 2, Easton, distribution line",
    ("lufkin", "distribution"): "Table 3, Lufkin, distribution line",
}


@dataclass(frozen=True, slots=True)
class Result:
    """What one filter keeps of one line's region, and of the survey's background [count]."""

    region: Counts
    far: Counts
    plain_noise_kept: int
    background: int
    background_kept: int

    def __add__(self, other: "Result") -> "Result":
        return Result(
            self.region + other.region,
            self.far + other.far,
            self.plain_noise_kept + other.plain_noise_kept,
            self.background + other.background,
            self.background_kept + other.background_kept,
        )


def wire_tables(
    folder: Path, seeds: Sequence[int], twins: Sequence[str] = tuple(BRIGHTER)
) -> dict[tuple[str, str, str], Result]:
    """Print the tables of some twins, pooled over seeds; results by twin, kind and method."""
    known = methods.known_methods()
    skipped = {"calibrated", "voxel", "multilevel", "cylinder"}
    found: dict[tuple[str, str, str], Result] = {}
    chosen = {key: method for key, method in known.items() if key not in skipped}
    for name in twins:
        found |= _measure(name, folder, seeds, chosen)
        found |= _measure(BRIGHTER[name], folder, seeds, {k: known[k] for k in BRIGHT})
    for twin, kind in PUBLISHED:
        if twin in twins:
            _print(twin, kind, found, known)
    return found


def _measure(
    name: str,
    folder: Path,
    seeds: Sequence[int],
    chosen: Mapping[str, Method],
) -> dict[tuple[str, str, str], Result]:
    found: dict[tuple[str, str, str], Result] = {}
    for seed in seeds:
        survey = methods.make_survey(TWINS[name](seed), folder / f"{name.replace(' ', '_')}_{seed}")
        points = methods.load_truth(survey)
        noise = points["kind"] == BACKGROUND
        lines = [
            (kind, corridors.region(spans, points), corridors.nearest_m(spans, points))
            for kind, spans in corridors.lines(survey)
        ]
        for key, method in chosen.items():
            kept = methods.judge(survey, method) == 0
            for kind, within, distance in lines:
                result = Result(
                    corridors.count(points, kept, within),
                    corridors.count(points, kept, within & (distance > SPHERE_M)),
                    int((kept & within & noise & (distance > CLOSE_M)).sum()),
                    int(noise.sum()),
                    int((kept & noise).sum()),
                )
                at = (name, kind, key)
                found[at] = found[at] + result if at in found else result
    return found


def _print(
    twin: str,
    kind: str,
    found: Mapping[tuple[str, str, str], Result],
    known: Mapping[str, Method],
) -> None:
    columns = (
        "detected", "[W18]", "false al.", "[W18]", "by eye", "> 1.5 m", "noise kept", "wire",
        "noise",
    )  # fmt: skip
    print(f"\n{TITLES[twin, kind]} [%; wire and noise returns of the region]")
    print(f"{'':28s}" + "".join(f"{c:>11s}" for c in columns))
    source = PUBLISHED[twin, kind]
    for label, name in (("", twin), ("bright, ", BRIGHTER[twin])):
        for (of, line, key), result in found.items():
            if (of, line) == (name, kind):
                _print_row(label + known[key].label, result, source.get(key))


def _print_row(label: str, r: Result, source: Counts | None) -> None:
    """One method on one twin, beside the source's figures."""
    kept = r.region.wire_kept + r.region.noise_kept
    detection, false_alarm = (source.detection, source.false_alarm) if source else (np.nan, np.nan)
    figures = (
        r.region.detection, detection, r.region.false_alarm, false_alarm,
        100.0 * r.plain_noise_kept / max(kept, 1), 100.0 * r.far.noise_kept / max(r.far.noise, 1),
        100.0 * r.background_kept / max(r.background, 1),
    )  # fmt: skip
    print(
        f"{label:28s}"
        + "".join(f"{v:11.1f}" if np.isfinite(v) else f"{'-':>11s}" for v in figures)
        + f"{r.region.wire:11d}{r.region.noise:11d}"
    )
