"""Afterpulses everywhere: removed and lost, against the best that the physics allows.

``python -m benchmarks.airborne.afterpulse.afterpulses [FOLDER] [--only bounds canopies lights
surfaces]`` simulates
canopies that differ in afterpulse law, extinction, brightness and ground occupancy, roofs, and
clear water with a bottom, into FOLDER (a temporary one by default). The method is told the
preset's law only (p 0.15, scale 0.7 m): what it uses is fitted. Lags beyond the dead time are
exponential and end 3 m behind the parent; 0.1-0.2 afterpulses follow a detection ([W17] 7.5: 10-20
on 80-100 signal returns, within 2-3 m).

In crowns a true second return has the same signature. How often, and what tells the two apart,
depends on how leaves hang: evenly through a crown, or in clumps with air between them, where other
beamlets see nothing. Both are simulated. The *bound* orders followers by the
probability that the simulation's own laws give them
(:mod:`benchmarks.airborne.afterpulse.afterpulse_bound`): no filter
that sees returns can remove more at the same loss. Lost are vegetation returns, in percent of all
of them. The first table is the bound alone, by afterpulses per detection, their scale and the
canopy's extinction; the last one of vegetation tells what less light changes. The pulse's energy
stands for all that makes leaves brighter, and set-ups of [W18] for what surveys have of it.
"""

import argparse
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.airborne.afterpulse.afterpulse_scenes import (
    BOUNDS,
    CANOPIES,
    CLUMP_EXTINCTION,
    FLIGHTS,
    LIGHTS,
    ROOFS,
    WATERS,
    clumps,
    scene,
    trees,
)
from benchmarks.airborne.afterpulse.afterpulse_tables import Prepared, prepare
from spl_batch.airborne.afterpulse import afterpulse_decision
from spl_batch.airborne.filter.denoise import denoise
from spl_batch.airborne.settings import AfterpulseSettings, FilterSettings
from spl_batch.airborne.simulate.survey import KINDS
from spl_batch.constants import NOISE_AFTERPULSE, NOISE_SIGNAL, QUANTUM_M

BACKGROUND, GROUND, ROOF, VEGETATION, WATER, AFTERPULSE, BOTTOM = (
    KINDS.index(name)
    for name in ("background", "ground", "roof", "vegetation", "water", "afterpulse", "bottom")
)
PUBLISHED = 90.6
"""Share of afterpulses removed on roofs, [W17] Table 7-1 [%]."""

LOST_MAX = 0.02
"""Share of vegetation returns that may go."""

LOSSES = (0.005, 0.01, 0.02, 0.04, 0.08)
"""Shares of vegetation lost at which the bound is printed."""

SHALLOW_M = 1.5
"""Depth that divides bottoms: on banks they slope, close behind the surface [m]."""

FOOTPRINT_M = 4.0
"""A shot centred farther inside is wholly over the trees [m]."""

THRESHOLDS = (0.5, 0.6, 0.65, 0.7, 0.75, 0.8, 0.85, 0.9, 0.95)


def main(folder: Path, parts: Sequence[str]) -> dict[str, dict[str, float]]:
    """Print the tables; figures by scene."""
    found: dict[str, dict[str, float]] = {}
    for part in parts:
        found |= PARTS[part](folder)
    return found


def canopies(folder: Path) -> dict[str, dict[str, float]]:
    """Print what is removed and lost in canopies of the preset's light; figures by scene."""
    found: dict[str, dict[str, float]] = {}
    print("Vegetation: afterpulses removed [%] where 2 % of vegetation is lost, and by default")
    names = ("p", "fitted", "scale m", "fitted", "bound", "place", "ours", "shot", "default",
             "lost", "bound 80", "ground-")  # fmt: skip
    print(f"{'':28s}" + "".join(f"{n:>9s}" for n in names))
    curve = ""
    for content in CANOPIES:
        name = content["name"]
        survey = prepare(content, folder / name.replace(" ", "_"))
        law = content["sensor_overrides"]
        found[name] = {
            "true p": law["afterpulse_probability"],
            "p": 0.0,
            "true scale": law["afterpulse_scale_m"],
            **vegetation(survey),
        }
        print(f"{name:28s}" + "".join(f"{v:9.3f}" for v in found[name].values()), flush=True)
        curve = curve or curves(survey)
    print("p and scale: simulated, fitted; place: of what the bound knows only the true rate")
    print("bound 80: lost where the bound removes 80 %; ground-: lost\n")
    print(f"Removed / lost [%] by threshold, {CANOPIES[0]['name']}\n{curve}")
    return found


def surfaces(folder: Path) -> dict[str, dict[str, float]]:
    """Print what the whole filter keeps and removes at roofs and water; figures by scene."""
    found: dict[str, dict[str, float]] = {}
    print("Labels of the whole filter [%]: kept and removed; published is for roofs")
    for content, polygons in [(ROOFS, True), *((w, p) for w in WATERS for p in (True, False))]:
        name = content["name"]
        survey = prepare(content, folder / name.replace(" ", "_"), polygons=polygons)
        title = name + ("" if polygons else ", no polygon")
        found[title] = labels(survey)
        for key, value in found[title].items():
            print(f"{title:34s} {key:42s} {value:8.2f}", flush=True)
    print(f"{'':34s} {'published, roofs':42s} {PUBLISHED:8.2f}")
    return found


def bounds(folder: Path) -> dict[str, dict[str, float]]:
    """Print the bound by law and canopy; figures by scene."""
    print(
        "Bound: afterpulses of vegetation removed [%] where this share of vegetation is lost [%];"
    )
    print(
        "lost where 80 % are removed; share of beamlets with a return; true returns of vegetation"
    )
    print(
        f"that follow another one, per afterpulse of it ({len(BOUNDS)} canopies of one flightline)"
    )
    heads = [f"at {100 * x:g}" for x in LOSSES] + ["for 80", "seen", "leaves"]
    print("".join(f"{h:>9s}" for h in ("p", "scale m", "extinct.", *heads)))
    found = {}
    for k, (law, extinction) in enumerate(BOUNDS):
        leaves = clumps if extinction == CLUMP_EXTINCTION else trees
        content = scene(f"bound {k}", 31 + k, law, trees=leaves(extinction_per_m=extinction),
                        flights=FLIGHTS[:1], extent_m=[50, 50])  # fmt: skip
        survey = prepare(content, folder / f"bound_{k}")
        true, false = leaves_and_echoes(survey)
        found[content["name"]] = row = {
            **{f"at {x}": removed_at(survey.bound, true, false, x) for x in LOSSES},
            "for 80": lost_at(survey.bound, true, false, 0.8),
            **brightness(survey),
        }
        cells = "".join(f"{v:9.3g}" for v in (*law, extinction))
        print(cells + "".join(f"{row[h]:9.2f}" for h in row if h != "returns"), flush=True)
    print()
    return found


def lights(folder: Path) -> dict[str, dict[str, float]]:
    """Print what less light changes; figures by scene."""
    print(
        "Vegetation by light: true and afterpulse returns per m2 and flightline, share of beamlets"
    )
    print(
        "that have one [%], true followers per afterpulse; removed [%] where 2 % are lost, and by"
    )
    print("default, and lost then")
    names = ("returns", "seen", "leaves", "bound", "ours", "shot", "default", "lost")
    print(f"{'':30s}" + "".join(f"{n:>9s}" for n in names))
    found = {}
    for content in LIGHTS:
        name = content["name"]
        survey = prepare(content, folder / name.replace(" ", "_"))
        row = {**brightness(survey), **vegetation(survey)}
        row["returns"] /= len(content["flights"])
        found[name] = row
        print(f"{name:30s}" + "".join(f"{row[n]:9.2f}" for n in names), flush=True)
    print()
    return found


def brightness(survey: Prepared) -> dict[str, float]:
    """Returns per m2, share of beamlets that have one [%], true followers per afterpulse.

    Background is left out, and shots that are not wholly over the trees' square.
    """
    table = survey.table.take(np.flatnonzero(survey.kind != BACKGROUND))
    shot = np.unique(table["gps_time"], return_inverse=True)[1]
    inside, over = np.ones(len(table), np.bool_), np.ones(int(shot.max()) + 1, np.bool_)
    area = 1.0
    for axis in "xy":
        at, leaves = table[axis], survey.table[axis][survey.kind == VEGETATION]
        low, high, edge = leaves.min(), leaves.max(), FOOTPRINT_M / QUANTUM_M
        centre = np.bincount(shot, at) / np.bincount(shot)
        inside &= (at >= low) & (at <= high)
        over &= (centre >= low + edge) & (centre <= high - edge)
        area *= float(high - low) * QUANTUM_M
    seen = np.unique(shot[over[shot]] * 256 + table["channel"][over[shot]])
    true, false = leaves_and_echoes(survey)
    return {
        "returns": inside.sum() / area,
        "seen": len(seen) / over.sum(),
        "leaves": float((true & (survey.table["afterpulse_rate"] > 0)).sum() / false.sum()),
    }


def leaves_and_echoes(survey: Prepared) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """True returns of vegetation, and afterpulses of vegetation: two (n,) bool."""
    echo = (survey.kind == AFTERPULSE) & (survey.parent == VEGETATION)
    return survey.kind == VEGETATION, echo


def scores(survey: Prepared) -> NDArray[np.float64]:
    """Probability of each return, 2 where it is an afterpulse at any threshold."""
    rows, chance, hard, *_ = afterpulse_decision.probability(survey.table, survey.density)
    echo = afterpulse_decision.resolve(survey.table, survey.density, AfterpulseSettings()).echo
    score = np.zeros(len(survey.table))
    score[rows] = np.where(hard, np.where(echo[rows], 2.0, 0.0), chance)
    return score


def vegetation(survey: Prepared) -> dict[str, float]:
    """One row of the first table."""
    true, false = leaves_and_echoes(survey)
    echo = afterpulse_decision.resolve(survey.table, survey.density, AfterpulseSettings()).echo
    return {
        "p": float(np.mean([law.probability for law in survey.laws])),
        "scale": float(np.mean([law.scale_m for law in survey.laws])),
        "bound": removed_at(survey.bound, true, false, LOST_MAX),
        "place": removed_at(survey.place, true, false, LOST_MAX),
        "ours": removed_at(scores(survey), true, false, LOST_MAX),
        "shot": removed_at(survey.table["afterpulse"], true, false, LOST_MAX),
        "default": 100 * float(echo[false].mean()),
        "lost": 100 * float(echo[true].mean()),
        "bound 80": lost_at(survey.bound, true, false, 0.8),
        "ground": 100 * float(echo[survey.kind == GROUND].mean()),
    }


def removed_at(
    score: NDArray[np.floating], true: NDArray[np.bool_], false: NDArray[np.bool_], lost: float
) -> float:
    """Share of the false ones above the threshold that loses a share of the true ones [%]."""
    limit = np.sort(score[true])[::-1][int(lost * true.sum())]
    return 100 * float((score[false] > limit).mean())


def lost_at(
    score: NDArray[np.floating], true: NDArray[np.bool_], false: NDArray[np.bool_], removed: float
) -> float:
    """Share of the true ones above the threshold that removes a share of the false ones [%]."""
    limit = np.sort(score[false])[::-1][int(removed * false.sum())]
    return 100 * float((score[true] > limit).mean())


def curves(survey: Prepared) -> str:
    """Removed and lost by threshold: the bound, ours, and the ground beside it."""
    true, false = leaves_and_echoes(survey)
    hard = (survey.kind == AFTERPULSE) & (survey.parent == GROUND)
    score = scores(survey)
    lines = [
        f"{'threshold':>10s}{'bound':>18s}{'ours':>18s}{'under ground':>14s}{'ground lost':>13s}"
    ]
    for limit in THRESHOLDS:
        shares = [100 * float((s[m] >= limit).mean())
                  for s in (survey.bound, score) for m in (false, true)]  # fmt: skip
        under, ground = (100 * float((score[m] >= limit).mean())
                         for m in (hard, survey.kind == GROUND))  # fmt: skip
        lines.append(
            f"{limit:10.2f}" + "".join(f"{a:10.1f} /{b:6.2f}" for a, b in (shares[:2], shares[2:]))
            + f"{under:14.2f}{ground:13.3f}"
        )  # fmt: skip
    return "\n".join(lines) + "\n"


def labels(survey: Prepared) -> dict[str, float]:
    """Shares by the labels that the whole filter gives."""
    everything = np.ones(len(survey.table), np.bool_)
    found = denoise(survey.table, survey.density, everything, FilterSettings())["noise_class"]
    kind, parent = survey.kind, survey.parent
    out = {}
    for name, number in (("roof", ROOF), ("ground", GROUND), ("bottom", BOTTOM)):
        mine = kind == number
        if mine.any():
            echo = (kind == AFTERPULSE) & (parent == number)
            out[f"{name} kept"] = 100 * float((found[mine] == NOISE_SIGNAL).mean())
            out[f"{name} taken for afterpulses"] = 100 * float(
                (found[mine] == NOISE_AFTERPULSE).mean()
            )
            out[f"afterpulses of {name} removed"] = 100 * float(
                (found[echo] != NOISE_SIGNAL).mean()
            )
    bottom = kind == BOTTOM
    if bottom.any():
        level = np.median(survey.table["z"][kind == WATER])
        shallow = level - survey.table["z"] < round(SHALLOW_M / QUANTUM_M)
        for name, mine in (("shallower", bottom & shallow), ("deeper", bottom & ~shallow)):
            if mine.any():
                kept = 100 * float((found[mine] == NOISE_SIGNAL).mean())
                out[f"bottom kept, {name} than {SHALLOW_M:g} m"] = kept
    return out


PARTS = {"bounds": bounds, "canopies": canopies, "lights": lights, "surfaces": surfaces}
"""What prints each table, given a folder."""


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--only", nargs="+", choices=list(PARTS), default=list(PARTS))
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        main(given.folder or Path(temporary), given.only)
