"""Figures of the noise model, the filter and afterpulses."""

from collections.abc import Iterator
from typing import Final

import numpy as np

from benchmarks.airborne import sky, sky_figures
from benchmarks.airborne.afterpulse import afterpulses, lag_laws
from benchmarks.airborne.afterpulse.afterpulse_scenes import CANOPIES, ROOFS
from benchmarks.airborne.afterpulse.afterpulse_tables import prepare
from benchmarks.airborne.filter import methods, p_values, wires
from benchmarks.airborne.noise import noise_density
from benchmarks.airborne.published.twins import TWINS
from benchmarks.held import surveys
from benchmarks.held.figures import Figure, Moves, chosen, figure
from benchmarks.held.surveys import Given

SEED: Final = 1

DENSITIES: Final = (0.02, 0.1, 0.4, 1.0)
"""Of pure noise [1/m3]."""

POINTS, DRAWS, ALPHA = 60_000, 2, 0.001
"""Noise points of a draw, draws [count], and the filter's alpha."""

UNIFORM: Final = (0.01, 0.1, 0.5)
"""Values x at which the share of p <= x is looked at."""


def noise(given: Given) -> Iterator[Figure]:
    """Expected over true noise, in strata."""
    known: dict[tuple[str, ...], noise_density.Voxels] = {}
    for name, scene, overrides, region in noise_density.STRATA:
        folder = noise_density.simulated(scene, SEED, given.scratch / "noise")
        if (scene, *overrides) not in known:
            known[scene, *overrides] = noise_density.voxels(folder, overrides)
        voxels = known[scene, *overrides]
        mask = region(voxels)
        ratio = float(voxels.expected[mask].sum() / voxels.true[mask].sum())
        yield figure(f"expected / true noise, {name}", ratio, tolerance=0.01)


def alpha(given: Given) -> Iterator[Figure]:
    """Pure noise that is kept over alpha, and share of p <= x over x, by density."""
    del given
    for density in DENSITIES:
        drawn = [p_values.shares(k, density, POINTS, ALPHA) for k in range(DRAWS)]
        *shares, kept = np.mean(drawn, axis=0)
        yield figure(f"kept / alpha, {density:g} per m3", kept / ALPHA, tolerance=0.1)
        by_level = dict(zip(p_values.LEVELS, shares, strict=True))
        for level in UNIFORM:
            name = f"p <= {level:g} / {level:g}, {density:g} per m3"
            yield figure(name, by_level[level] / level, tolerance=0.03)


WIRES: Final[Moves] = {
    "wires": ("%", "less", 0.5),
    "far noise": ("%", "more", 0.02),
    "noise": ("%", "more", 0.1),
    "trees": ("%", "less", 0.3),
    "poles": ("%", "less", 1.0),
}


def conductors(given: Given) -> Iterator[Figure]:
    """Weak and ordinary wires that are kept, and noise far from everything that is kept."""
    ours = methods.known_methods()["ours"]
    for scene in wires.BARS:
        survey = methods.make_survey(TWINS[scene](SEED), given.scratch / f"{scene}_wires")
        kept = methods.judge(survey, ours) == 0
        groups = wires.strata(survey, methods.load_truth(survey))
        shares = {name: methods.share(kept, mask) for name, mask in groups.items()}
        yield from chosen(shares, WIRES, f"{scene}, kept: ")


HARD: Final[Moves] = {
    "roof kept": ("%", "less", 0.1),
    "ground kept": ("%", "less", 0.05),
    "afterpulses of roof removed": ("%", "less", 0.3),
    "afterpulses of ground removed": ("%", "less", 0.3),
}
LEAVES: Final[Moves] = {
    "default": ("%", "less", 1.0),
    "lost": ("%", "more", 0.1),
    "ours": ("%", "less", 1.0),
    "ground": ("%", "more", 0.05),
}
TAILS: Final[Moves] = {
    "removed %": ("%", "less", 0.3),
    "hard kept %": ("%", "less", 0.1),
    "trees kept %": ("%", "less", 0.3),
    "DTM RMSE cm": ("cm", "more", 0.3),
}
CANOPY: Final = ("canopy", "clumps of leaves")
LAGS: Final = ("power law, 0.25, 15 m", "two exponentials, 0.25, 15 m")


def afterpulse(given: Given) -> Iterator[Figure]:
    """Afterpulses of roofs, ground and vegetation, and with long tails."""
    folder = given.scratch / "afterpulse"
    yield from chosen(afterpulses.labels(prepare(ROOFS, folder / "roofs")), HARD)
    for content in CANOPIES:
        if content["name"] in CANOPY:
            survey = prepare(content, folder / content["name"])
            yield from chosen(afterpulses.vegetation(survey), LEAVES, f"{content['name']}: ")
    for number, name in enumerate(LAGS):
        detector = lag_laws.ROWS[name]
        survey = lag_laws.made(detector, folder / f"lags_{number}")
        plain = lag_laws.made(
            {**detector, "afterpulse_probability": 0.0}, folder / f"plain_{number}"
        )
        without, _ = lag_laws.run(plain, "out")
        out, _ = lag_laws.run(survey, "out")
        yield from chosen(lag_laws.figures(survey, out, without), TAILS, f"{name}: ")


SKY: Final[Moves] = {
    "noise removed": ("%", "less", 0.3),
    "far noise kept": ("%", "more", 0.05),
    "ground": ("%", "less", 0.1),
    "vegetation": ("%", "less", 0.5),
    "wire": ("%", "less", 1.0),
    "DSM > 1 m": ("%", "more", 0.1),
    "DTM rmse": ("m", "more", 0.005),
}
SKIES: Final = (
    "base", "haze 60-100 m, 20 x", "haze 25-45 m, 30 x", "closed cloud 70-110 m, 20 x",
    "thinner haze 8-14 m, 20 x", "sheet of 2 m at 30 m, 40 x", "fog, 1.5 m, 60 x",
)  # fmt: skip


def haze(given: Given) -> Iterator[Figure]:
    """What layers of haze leave in clouds and rasters."""
    assert set(SKIES) <= set(sky.EFFECTS)
    for name in SKIES:
        yield from chosen(sky_figures.measure(surveys.in_sky(given, name)), SKY, f"{name}: ")
