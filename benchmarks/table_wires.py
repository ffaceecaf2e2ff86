"""[W18] Tables 1-3 on the twins of Easton and Lufkin; called by :mod:`benchmarks.tables`.

Misprints, with the counts of the source put right: distribution lines of Easton 60.0 % detected
(12,265 of 20,793 is 59.0 %); DCC's false alarm there 41.6 % (639 of 2944 is 21.7 %).

Beside the source's two figures stand those that explain where ours differ:

- "by eye": false alarms farther than half a metre from every wire that are no afterpulses. A human
  who sorts returns by eye puts what lies on a wire to the wire.
- "noise kept": share of all the survey's background that the filter keeps.
- "bright": the twin with wires of four times the diameter. The source's own figures say that
  its regions held a few times more wire than noise; as the link budget has it, the twins' hold more
  noise than wire (last columns), part of it afterpulses of the wires.
- "merged" against "lines alone": AES and VSAES each on all flightlines and on each by itself. What
  sets VSAES apart in the source, where AES runs on single flightlines, is the merging.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks import corridors, methods
from benchmarks.corridors import Counts
from benchmarks.methods import BACKGROUND, Method
from benchmarks.twins import TWINS

PUBLISHED: Mapping[tuple[str, str], Mapping[str, tuple[float, float]]] = {
    ("easton", "transmission"): {
        "published": (89.1, 5.4), "aes_alone": (25.9, 5.1), "dcc": (13.4, 20.8),
    },
    ("easton", "distribution"): {
        "published": (59.0, 7.8), "aes_alone": (29.3, 8.9), "dcc": (11.1, 21.7),
    },
    ("lufkin", "distribution"): {
        "published": (85.9, 5.5), "aes_alone": (37.9, 6.2), "dcc": (6.1, 13.3),
    },
}  # fmt: skip
"""Detection and false alarm of [W18] Tables 1-3 [%], by twin and kind of line, by method."""

BRIGHTER = {"easton": "bright", "lufkin": "lufkin bright"}
"""Twin of bright wires by twin."""

BRIGHT = ("published", "aes_alone", "dcc", "ours")
"""Methods that are run on the twins of bright wires."""

CLOSE_M = 0.5
"""Noise nearer to a wire than this is classed with it by eye [m]."""

TITLES = {
    ("easton", "transmission"): "Table 1, Easton, transmission line",
    ("easton", "distribution"): "Table 2, Easton, distribution line",
    ("lufkin", "distribution"): "Table 3, Lufkin, distribution line",
}


@dataclass(frozen=True, slots=True)
class Result:
    """What one filter keeps of one line's region, and of the survey's background [count]."""

    region: Counts
    plain_noise_kept: int
    background: int
    background_kept: int

    def __add__(self, other: "Result") -> "Result":
        return Result(
            self.region + other.region,
            self.plain_noise_kept + other.plain_noise_kept,
            self.background + other.background,
            self.background_kept + other.background_kept,
        )


def wire_tables(folder: Path, seeds: Sequence[int]) -> dict[tuple[str, str, str], Result]:
    """Print Tables 1-3, pooled over seeds; results by twin, kind of line and method."""
    known = methods.known_methods()
    skipped = {"tail", "calibrated", "voxel", "multilevel", "cylinder"}
    found: dict[tuple[str, str, str], Result] = {}
    chosen = {key: method for key, method in known.items() if key not in skipped}
    for name in ("easton", "lufkin"):
        found |= _measure(name, folder, seeds, chosen)
        found |= _measure(BRIGHTER[name], folder, seeds, {k: known[k] for k in BRIGHT})
    for (twin, kind), published in PUBLISHED.items():
        _print(twin, kind, found, published, known)
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
    published: Mapping[str, tuple[float, float]],
    known: Mapping[str, Method],
) -> None:
    columns = ("detected", "[W18]", "false al.", "[W18]", "by eye", "noise kept", "wire", "noise")
    print(f"\n{TITLES[twin, kind]} [%; wire and noise returns of the region]")
    print(f"{'':28s}" + "".join(f"{c:>11s}" for c in columns))
    rows = [(key, r) for (t, k, key), r in found.items() if (t, k) == (twin, kind)]
    rows += [
        (f"bright {key}", r) for (t, k, key), r in found.items()
        if (t, k) == (BRIGHTER[twin], kind)
    ]  # fmt: skip
    for key, r in rows:
        detection, false_alarm = published.get(key.removeprefix("bright "), (np.nan, np.nan))
        kept = r.region.wire_kept + r.region.noise_kept
        figures = (
            r.region.detection, detection, r.region.false_alarm, false_alarm,
            100.0 * r.plain_noise_kept / max(kept, 1),
            100.0 * r.background_kept / max(r.background, 1),
        )  # fmt: skip
        label = f"bright, {known[key[7:]].label}" if key.startswith("bright ") else known[key].label
        print(
            f"{label:28s}"
            + "".join(f"{v:11.1f}" if np.isfinite(v) else f"{'-':>11s}" for v in figures)
            + f"{r.region.wire:11d}{r.region.noise:11d}"
        )
