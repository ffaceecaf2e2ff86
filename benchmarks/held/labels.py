"""What runs keep and remove, by the true kind of the returns: wires, afterpulses, haze."""

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
from scipy.spatial import KDTree

from benchmarks.held import scenes, surveys, truth
from benchmarks.held.figures import Figure, Moves, chosen
from benchmarks.held.surveys import Given
from benchmarks.held.truth import Mask, Points, share

THIN_M: Final = 0.5
"""Returns are thinned to cells of this size before distances to them are taken [m]."""

WIRES: Final[Moves] = {
    "wires": ("%", "less", 0.5),
    "far noise": ("%", "more", 0.02),
    "noise": ("%", "more", 0.1),
    "trees": ("%", "less", 0.3),
    "poles": ("%", "less", 1.0),
}


def conductors(given: Given) -> Iterator[Figure]:
    """Weak and ordinary wires that are kept, and noise far from everything that is kept.

    Far is 5 m from every true return. Afterpulses are none: background has its own, which lie
    everywhere.
    """
    for name in ("weak", "ordinary"):
        survey = surveys.once(scenes.wires(name, 1), given.scratch / f"{name}_wires")
        table = truth.points(survey)
        kept, noise = table["noise_class"] == 0, truth.of(table, "background")
        groups = {
            "wires": truth.of(table, "wire"),
            "far noise": noise & _far(table, noise, 5.0, THIN_M),
            "noise": noise,
            "trees": truth.of(table, "vegetation"),
            "poles": truth.of(table, "other"),
        }
        shares = {group: share(kept, mask) for group, mask in groups.items()}
        yield from chosen(shares, WIRES, f"{name}, kept: ")


def _far(table: Points, asked: Mask, far_m: float, thin_m: float | None = None) -> Mask:
    """Which of the returns that are asked for are farther than this from all true returns."""
    xyz = np.column_stack([table[axis] for axis in "xyz"])
    xyz -= xyz.min(axis=0)
    rest = xyz[~truth.is_noise(table)]
    if thin_m:
        _, first = np.unique(np.floor(rest / thin_m).astype(np.int64), axis=0, return_index=True)
        rest = rest[first]
    rows = np.flatnonzero(asked)
    distance = KDTree(rest).query(xyz[rows], distance_upper_bound=far_m)[0]
    far = np.zeros(len(xyz), dtype=np.bool_)
    far[rows[np.isinf(distance)]] = True
    return far


HARD: Final[Moves] = {
    "roof kept": ("%", "less", 0.1),
    "ground kept": ("%", "less", 0.05),
    "afterpulses of roof removed": ("%", "less", 0.3),
    "afterpulses of ground removed": ("%", "less", 0.3),
}
LEAVES: Final[Moves] = {
    "default": ("%", "less", 1.0),
    "lost": ("%", "more", 0.1),
    "ground": ("%", "more", 0.05),
}
TAILS: Final[Moves] = {
    "removed %": ("%", "less", 0.3),
    "hard kept %": ("%", "less", 0.1),
    "trees kept %": ("%", "less", 0.3),
    "DTM RMSE cm": ("cm", "more", 0.3),
}


def afterpulse(given: Given) -> Iterator[Figure]:
    """Afterpulses of roofs, ground and vegetation, and with long tails."""
    folder = given.scratch / "afterpulse"
    yield from chosen(_hard(surveys.once(scenes.ROOFS, folder / "roofs")), HARD)
    for content in scenes.CANOPIES:
        survey = surveys.once(content, folder / content["name"].replace(" ", "_"))
        yield from chosen(_leaves(survey), LEAVES, f"{content['name']}: ")
    without = surveys.once(scenes.lags(None), folder / "without", "reference=null")
    for number, (name, tail) in enumerate(scenes.LAGS.items()):
        survey = surveys.once(scenes.lags(tail), folder / f"lags_{number}", "reference=null")
        yield from chosen(_tail(survey, without), TAILS, f"{name}: ")


def _hard(survey: Path) -> dict[str, float]:
    table = truth.points(survey)
    kept, found = table["noise_class"] == 0, {}
    for name in ("roof", "ground"):
        found[f"{name} kept"] = share(kept, truth.of(table, name))
        found[f"afterpulses of {name} removed"] = share(~kept, truth.echoes(table, name))
    return found


def _leaves(survey: Path) -> dict[str, float]:
    """Afterpulses of vegetation that are removed, and true returns that are called afterpulses."""
    table = truth.points(survey)
    called = table["noise_class"] == 2
    return {
        "default": share(called, truth.echoes(table, "vegetation")),
        "lost": share(called, truth.of(table, "vegetation")),
        "ground": share(called, truth.of(table, "ground")),
    }


def _tail(survey: Path, without: Path) -> dict[str, float]:
    """What goes and what stays, and the terrain against that without afterpulses."""
    table = truth.points(survey)
    kept = table["noise_class"] == 0
    off = truth.delivered(survey, "dtm") - truth.delivered(without, "dtm")
    return {
        "removed %": share(~kept, truth.echoes(table, "ground", "roof")),
        "hard kept %": share(kept, truth.of(table, "ground", "roof")),
        "trees kept %": share(kept, truth.of(table, "vegetation")),
        "DTM RMSE cm": 100 * truth.rms(off[np.isfinite(off)]),
    }


SKY: Final[Moves] = {
    "noise removed": ("%", "less", 0.3),
    "far noise kept": ("%", "more", 0.05),
    "ground": ("%", "less", 0.1),
    "vegetation": ("%", "less", 0.5),
    "wire": ("%", "less", 1.0),
    "DSM > 1 m": ("%", "more", 0.1),
    "DTM rmse": ("m", "more", 0.005),
}


def haze(given: Given) -> Iterator[Figure]:
    """What layers of haze leave in clouds and rasters."""
    for name in scenes.SKIES:
        survey = surveys.in_sky(given, name)
        table = truth.points(survey)
        kept, noise = table["noise_class"] == 0, truth.is_noise(table)
        found = {
            name: share(kept, truth.of(table, name)) for name in ("ground", "vegetation", "wire")
        }
        found["noise removed"] = share(~kept, noise)
        found["far noise kept"] = share(kept, _far(table, noise, 3.0))
        over = truth.delivered(survey, "dsm") - truth.around(truth.highest(survey, table))
        off = truth.delivered(survey, "dtm") - truth.raster(survey / "truth" / "dtm.tif")
        found["DSM > 1 m"] = 100 * float((over[np.isfinite(over)] > 1).mean())
        found["DTM rmse"] = truth.rms(off[np.isfinite(off)])
        yield from chosen(found, SKY, f"{name}: ")
