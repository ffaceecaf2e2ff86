"""Afterpulses everywhere: removed and lost, against the best that the physics allows.

``python -m benchmarks.afterpulses [FOLDER]`` simulates canopies that differ in afterpulse law,
extinction, brightness and ground occupancy, roofs, and clear water with a bottom, into FOLDER (a
temporary one by default). The method is told the preset's law only (p 0.15, scale 0.7 m): what
it uses is fitted. Lags beyond the dead time are exponential and end 3 m behind the parent; 0.1-0.2
afterpulses follow a detection ([W17] 7.5: 10-20 on 80-100 signal returns, within 2-3 m).

In crowns a true second return has the same signature. How often, and what tells the two apart,
depends on how leaves hang: evenly through a crown, or in clumps with air between them, where other
beamlets see nothing. Both are simulated. The *bound* orders followers by the
probability that the simulation's own laws give them (:mod:`benchmarks.afterpulse_bound`): no filter
that sees returns can remove more at the same loss. Lost are vegetation returns, in percent of all
of them. The first table is the bound alone, by afterpulses per detection, their scale, the canopy's
extinction, and brightness; the pulse's energy stands for all that makes leaves brighter.
"""

import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.afterpulse_tables import Prepared, prepare
from spl_batch.constants import NOISE_AFTERPULSE, NOISE_SIGNAL, QUANTUM_M
from spl_batch.settings import AfterpulseSettings, FilterSettings
from spl_batch.simulate.survey import KINDS
from spl_batch.stages import echoes
from spl_batch.stages.denoise import denoise

GROUND, ROOF, VEGETATION, WATER, AFTERPULSE, BOTTOM = (
    KINDS.index(name) for name in ("ground", "roof", "vegetation", "water", "afterpulse", "bottom")
)
PUBLISHED = 90.6
"""Share of afterpulses removed on roofs, [W17] Table 7-1 [%]."""

LOST_MAX = 0.02
"""Share of vegetation returns that may go."""

LOSSES = (0.005, 0.01, 0.02, 0.04, 0.08)
"""Shares of vegetation lost at which the bound is printed."""

SHALLOW_M = 1.5
"""Depth that divides bottoms: on banks they slope, close behind the surface [m]."""

THRESHOLDS = (0.5, 0.6, 0.65, 0.7, 0.75, 0.8, 0.85, 0.9, 0.95)
RING = [[20, 20], [80, 25], [85, 75], [30, 80]]
FLIGHTS = [
    {"heading_deg": 0, "offset_m": 300, "speed_m_s": 110},
    {"heading_deg": 90, "offset_m": -280, "speed_m_s": 110},
    {"heading_deg": 200, "offset_m": 350, "speed_m_s": 110, "sky": 1.3},
]


def scene(name: str, seed: int, law: tuple[float, float], **parts: Any) -> dict[str, Any]:
    """Content of a scene file; ``law`` is afterpulses per detection and their scale [m]."""
    return {
        "name": name,
        "extent_m": [100, 100],
        "seed": seed,
        "terrain": {"relief_m": 8},
        "flights": FLIGHTS,
        "sky": {"background_per_m3": 0.08},
        "acquisition": {"prf_hz": 30_000, "gate_m": 150},
        "sensor_overrides": {"afterpulse_probability": law[0], "afterpulse_scale_m": law[1]},
        **parts,
    }


def trees(**keys: float) -> dict[str, Any]:
    """A canopy of 60 % cover, its crowns evenly turbid."""
    return {"cover": 0.6, **keys}


def clumps(across_m: float = 0.8, **keys: float) -> dict[str, Any]:
    """Leaves in clumps about so far across, two along a vertical path, with air between them."""
    return {"cover": 0.85, "height_m": [3, 16],
            "radius_m": [0.375 * across_m, 0.625 * across_m], "crown_share": 0.075 * across_m,
            "extinction_per_m": 2.0, "gaps": 0.0, "understory": 0.0, **keys}  # fmt: skip


CANOPIES = (
    scene("canopy", 1, (0.15, 0.7), trees=trees()),
    scene("canopy, another seed", 21, (0.15, 0.7), trees=trees()),
    scene("open crowns", 2, (0.15, 0.7), trees=trees(extinction_per_m=0.2)),
    scene("dense crowns, p 0.2, 0.4 m", 3, (0.2, 0.4), trees=trees(extinction_per_m=0.6)),
    scene("p 0.1, 1.0 m", 11, (0.1, 1.0), trees=trees()),
    scene("p 0.2, 0.3 m", 14, (0.2, 0.3), trees=trees()),
    scene("dim leaves", 12, (0.15, 0.7), trees=trees(reflectance=0.12)),
    scene("dark ground", 15, (0.15, 0.7), trees=trees(), terrain={"reflectance": 0.08}),
    scene("one flightline", 13, (0.15, 0.7), trees=trees(), flights=FLIGHTS[:1]),
    scene("clumps of leaves", 16, (0.15, 0.7), trees=clumps(), extent_m=[50, 50]),
    scene("clumps, p 0.2, 0.3 m", 17, (0.2, 0.3), trees=clumps(), extent_m=[50, 50]),
    scene("clumps, one flightline", 18, (0.15, 0.7), trees=clumps(), extent_m=[50, 50],
          flights=FLIGHTS[:1]),
    scene("clumps, two flightlines", 41, (0.15, 0.7), trees=clumps(), extent_m=[50, 50],
          flights=FLIGHTS[:2]),
    scene("clumps, four flightlines", 42, (0.15, 0.7), trees=clumps(), extent_m=[50, 50],
          flights=[*FLIGHTS, {"heading_deg": 290, "offset_m": -250, "speed_m_s": 110}]),
    scene("clumps of 0.4 m", 43, (0.15, 0.7), trees=clumps(0.4), extent_m=[50, 50]),
    scene("clumps of 1.5 m", 44, (0.15, 0.7), trees=clumps(1.5), extent_m=[50, 50]),
    scene("clumps, extinction 1 /m", 45, (0.15, 0.7), trees=clumps(extinction_per_m=1.0),
          extent_m=[50, 50]),
    scene("clumps, extinction 4 /m", 46, (0.15, 0.7), trees=clumps(extinction_per_m=4.0),
          extent_m=[50, 50]),
)  # fmt: skip

USUAL_LAW, USUAL_EXTINCTION, USUAL_UJ = (0.15, 0.7), 0.35, 83.0
CLUMP_EXTINCTION = 2.0
BOUNDS = (
    *(
        ((p, 0.7), extinction, USUAL_UJ)
        for extinction in (0.15, 0.35, 0.7)
        for p in (0.1, 0.15, 0.2)
    ),
    *(((p, scale), USUAL_EXTINCTION, USUAL_UJ) for scale in (0.3, 1.0) for p in (0.1, 0.15, 0.2)),
    *((USUAL_LAW, USUAL_EXTINCTION, energy) for energy in (10.0, 20.0, 40.0, 160.0)),
    *(((p, 0.7), CLUMP_EXTINCTION, USUAL_UJ) for p in (0.1, 0.15, 0.2)),
    *(((0.15, scale), CLUMP_EXTINCTION, USUAL_UJ) for scale in (0.3, 1.0)),
)
"""Law, extinction of crowns or of clumps of leaves [1/m] and pulse energy [uJ] of the bound's
table."""

WATERS = (
    scene("lake of 2 m", 5, (0.15, 0.7), trees={"cover": 0.1}, water=[
        {"ring_m": RING, "depth_m": 2.0, "bank_slope": 0.15, "bottom_reflectance": 0.2}]),
    scene("bright surface, 1.2 m", 6, (0.15, 0.7), trees={"cover": 0.1}, water=[
        {"ring_m": RING, "depth_m": 1.2, "reflectance": 0.15, "bottom_reflectance": 0.1}]),
    scene("brighter, 3 m, turbid", 7, (0.2, 0.5), trees={"cover": 0.1}, water=[
        {"ring_m": RING, "depth_m": 3.0, "reflectance": 0.2, "bottom_reflectance": 0.15,
         "attenuation_per_m": 0.25}]),
)  # fmt: skip

ROOFS = scene("roofs", 4, (0.15, 0.7), buildings={"count": 8}, trees={"cover": 0.15},
              extent_m=[120, 120])  # fmt: skip


def main(folder: Path) -> dict[str, dict[str, float]]:
    """Print the tables; figures by scene."""
    found = bounds(folder)
    print("Vegetation: afterpulses removed [%] where 2 % of vegetation is lost, and by default")
    names = (
        "p",
        "scale m",
        "bound",
        "place",
        "ours",
        "shot",
        "default",
        "lost",
        "bound 80",
        "ground-",
    )
    print(f"{'':28s}" + "".join(f"{n:>9s}" for n in names))
    curve = ""
    for content in CANOPIES:
        name = content["name"]
        survey = prepare(content, folder / name.replace(" ", "_"))
        found[name] = vegetation(survey)
        print(f"{name:28s}" + "".join(f"{v:9.3f}" for v in found[name].values()), flush=True)
        curve = curve or curves(survey)
    print(
        "p and scale are fitted; place: of the bound's knowledge only the true rate at the place;"
    )
    print("bound 80: lost where the bound removes 80 %; ground-: lost\n")
    print(f"Removed / lost [%] by threshold, {CANOPIES[0]['name']}\n{curve}")
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
    """Print the bound by law, canopy and brightness; figures by scene."""
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
    print("".join(f"{h:>9s}" for h in ("p", "scale m", "extinct.", "energy", *heads)))
    found = {}
    for k, (law, extinction, energy) in enumerate(BOUNDS):
        # as many afterpulses of dim canopies as of bright ones
        side = min(max(70.0 * USUAL_UJ / energy, 70.0), 160.0)
        leaves = clumps if extinction == CLUMP_EXTINCTION else trees
        content = scene(f"bound {k}", 31 + k, law, trees=leaves(extinction_per_m=extinction),
                        flights=FLIGHTS[:1], extent_m=[side, side])  # fmt: skip
        content["sensor_overrides"]["pulse_energy_uj"] = energy
        found[content["name"]] = row = bound_row(prepare(content, folder / f"bound_{k}"))
        cells = "".join(f"{v:9.3g}" for v in (*law, extinction, energy))
        print(cells + "".join(f"{v:9.2f}" for v in row.values()), flush=True)
    print()
    return found


def bound_row(survey: Prepared) -> dict[str, float]:
    """One row of the bound's table."""
    true, false = leaves_and_echoes(survey)
    follows = survey.table["afterpulse_rate"] > 0
    shots = survey.table["shot"].astype(np.int64)
    fired = 100 * len(np.unique(shots))
    seen = len(np.unique(shots * 256 + survey.table["channel"]))
    return {
        **{f"at {x}": removed_at(survey.bound, true, false, x) for x in LOSSES},
        "for 80": lost_at(survey.bound, true, false, 0.8),
        "seen": 100 * seen / fired,
        "leaves": float((true & follows).sum() / false.sum()),
    }


def leaves_and_echoes(survey: Prepared) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """True returns of vegetation, and afterpulses of vegetation: two (n,) bool."""
    echo = (survey.kind == AFTERPULSE) & (survey.parent == VEGETATION)
    return survey.kind == VEGETATION, echo


def scores(survey: Prepared) -> NDArray[np.float64]:
    """Probability of each return, 2 where it is an afterpulse at any threshold."""
    rows, chance, hard = echoes.probability(survey.table, survey.density)
    echo = echoes.resolve(survey.table, survey.density, AfterpulseSettings()).echo
    score = np.zeros(len(survey.table))
    score[rows] = np.where(hard, np.where(echo[rows], 2.0, 0.0), chance)
    return score


def vegetation(survey: Prepared) -> dict[str, float]:
    """One row of the first table."""
    true, false = leaves_and_echoes(survey)
    echo = echoes.resolve(survey.table, survey.density, AfterpulseSettings()).echo
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


if __name__ == "__main__":
    if len(sys.argv) > 1:
        main(Path(sys.argv[1]))
    else:
        with tempfile.TemporaryDirectory() as temporary:
            main(Path(temporary))
