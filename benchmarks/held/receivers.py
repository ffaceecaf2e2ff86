"""Figures of the other receivers: altimetry, coincidence, water surfaces."""

from collections.abc import Iterator
from typing import Final

import numpy as np

from benchmarks.altimetry import labelled_tracks, photon_beams, profiles
from benchmarks.geiger.coincidence import known_scene
from benchmarks.geiger.water import water_surface as water
from benchmarks.held.figures import Figure, Moves, chosen, figure
from benchmarks.held.surveys import Given
from spl_batch.geiger.coincidence.simulate import SceneSettings
from spl_batch.geiger.water.simulate import Instrument

TRACKS: Final[Moves] = {
    "F1": ("", "less", 0.002),
    "profile RMSE": ("m", "more", 0.02),
    "in 1 sigma": ("", "either", 0.02),
    "in 2 sigma": ("", "either", 0.02),
}


def tracks(given: Given) -> Iterator[Figure]:
    """Signal and ground profile of simulated tracks."""
    del given
    for kind, colour, canopy in profiles.SCENES:
        track = next(profiles.tracks(kind, colour, canopy))
        found = dict(zip(photon_beams.MEASURES, profiles.ours(track), strict=True))
        yield from chosen(found, TRACKS, f"{kind}, {colour}, {canopy:.0%} wooded: ")


def labelled(given: Given) -> Iterator[Figure]:
    """Agreement with labels of real tracks."""
    found = [labelled_tracks.read_csv(path) for path in given.real("icesat2/*.csv")]
    for atl03 in given.real("icesat2/atl03*.h5"):
        atl08 = atl03.with_name(atl03.name.replace("atl03", "atl08"))
        found += labelled_tracks.read_atl03(atl03, atl08)
    for number, track in enumerate(found, 1):
        kept = labelled_tracks.ours(track).kept
        measured = labelled_tracks.measured(kept, track.label)
        for name, value in zip(("balanced", "F1", "floor"), measured, strict=True):
            if np.isfinite(value):
                yield figure(f"track {number}: {name}", value, "", "less", 0.005)


KNOWN: Final[Moves] = {
    "spurious above ground, 1/m2": ("1/m2", "more", 0.02),
    "precision within 9 cm, %": ("%", "less", 0.3),
    "completeness within 9 cm of open surfaces, %": ("%", "less", 0.3),
    "open spokes, height SD, cm": ("cm", "more", 0.1),
    "open spokes, height mean, cm": ("cm", "either", 0.1),
    "tri-bars resolved by number, cm": ("cm", "more", 0.0),
    "tri-bars resolved by intensity, cm": ("cm", "more", 0.0),
}


def coincidence(given: Given) -> Iterator[Figure]:
    """Points of coincidence processing against targets of the known scene."""
    del given
    for name in ("spokes", "bars"):
        scene = SceneSettings(**known_scene.PARTS[name])
        found = known_scene.measure(scene, ["bridge_sign"])
        yield from chosen(found["bridge_sign"], KNOWN, f"{name}: ")


ACQUISITIONS: Final = 4
WATER: Final = (("bias", "mm", 0.3), ("variance", "mm2", 0.5), ("MSE", "mm2", 3.0),
                ("mean normal", "deg", 0.2), ("pixel normals", "deg", 0.3))  # fmt: skip


def surface(given: Given) -> Iterator[Figure]:
    """Flat target, calm water and waves by our method, and ends of rays below waves."""
    del given
    seed = 1
    instrument = Instrument(seed=seed)
    ways, dead = water.calibrated_ways(instrument, seed)
    wet = instrument.model_copy(update=water.ON_WATER)
    for name, target, receiver, view in (
        ("hard", water.HARD, instrument, water.HARD_VIEW),
        ("calm", water.CALM, wet, water.WATER_VIEW),
        ("waves", water.WAVES, wet, water.WATER_VIEW),
    ):
        made = water.surfaces(target, receiver, view, dead, [ways["ours"]], ACQUISITIONS, 50 + seed)
        pairs = [(acquired, results[0]) for acquired, results in made]
        means = np.mean([water.errors(*pair) for pair in pairs], axis=0)
        for (what, unit, tolerance), value in zip(WATER, means, strict=True):
            yield figure(f"{name}: {what}", value, unit, "more", tolerance)
        if name == "waves":
            ends = [water.floor_errors(*pair, view) for pair in pairs]
            off = np.mean(ends, axis=0)
            yield figure("waves: ends of rays by the surface", 100 * off[2], "cm", "more", 0.5)
