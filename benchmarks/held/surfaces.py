"""Figures of ground, rasters and flightlines."""

from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np

from benchmarks.airborne import strips
from benchmarks.airborne.filter.methods import make_survey
from benchmarks.airborne.ground import ground_tiles, isprs, steep, terrain
from benchmarks.airborne.products import dtm_quality, intensity
from benchmarks.held import surveys
from benchmarks.held.figures import Figure, Moves, chosen, figure
from benchmarks.held.surveys import Given
from spl_batch import api
from spl_batch.airborne.settings import GroundSettings

SEED: Final = 11

GROUND: Final[Moves] = {
    "DTM RMSE on open ground cm": ("cm", "more", 0.1),
    "DTM mean |d| but on water cm": ("cm", "more", 0.2),
    "DTM mean |d| under canopy cm": ("cm", "more", 0.5),
    "DTM mean |d| under roofs cm": ("cm", "more", 1.0),
    "DTM cells off by > 0.5 m per 10 000": ("1e-4", "more", 3.0),
    "DSM pits in roofs per 10 000": ("1e-4", "more", 0.5),
    "DSM pits in canopy per 10 000": ("1e-4", "more", 0.5),
    "DSM spikes per 10 000": ("1e-4", "more", 0.5),
}
STEEP: Final[Moves] = {
    "ground": ("%", "less", 0.2),
    "rmse": ("m", "more", 0.01),
    "> 0.5 m": ("%", "more", 0.1),
    "< -0.5 m": ("%", "more", 0.1),
    "floor": ("m", "more", 0.1),
    "objects": ("%", "more", 0.1),
}
WOODS: Final = ("hill", "town", "mountain")
SLOPES: Final = (
    "ridges 50 deg, trees", "cliff 15 m, trees", "dam and terrace, 60 deg", "bridge over a valley",
)  # fmt: skip


def ground(given: Given) -> Iterator[Figure]:
    """Terrain and surface of simulated woods, a town, steep ground and a bridge."""
    for name in WOODS:
        survey = terrain.simulated(name, SEED, given.scratch / "terrain")
        surveys.run(survey / "workflow.yaml")
        truth = terrain.load_truth(survey)
        dtm, dsm = (terrain.cut(survey / "out" / f"{n}.tif", survey) for n in ("dtm", "dsm"))
        found = terrain.terrain_figures(dtm, truth) | terrain.surface_figures(dsm, truth)
        yield from chosen(found, GROUND, f"{name}: ")
    for name in SLOPES:
        survey = steep.process(name, SEED, 1.0, given.scratch / "steep")
        true, kept = steep.load(survey)
        found = steep.figures(true, kept, kept.called, steep.delivered(survey, true))
        yield from chosen(found, STEEP, f"{name}: ")


def samples(given: Given) -> Iterator[Figure]:
    """Kappa and total error of the default method on the ISPRS samples."""
    settings = GroundSettings()
    for path in given.real("isprs/samp*.la[sz]"):
        table, truth = isprs.read(path)
        found = isprs.score(isprs.by_cells(table, settings), truth)
        yield figure(f"{path.name[:6]}: kappa", found.kappa, "%", "less", 0.3)
        yield figure(f"{path.name[:6]}: total error", found.total_error, "%", "more", 0.2)


TILES: Final[Moves] = {
    "RMSE": ("m", "more", 0.01),
    "> 0.5 m": ("%", "more", 0.2),
    "< -0.5 m": ("%", "more", 0.2),
    "roofs": ("%", "more", 0.2),
    "shrubs": ("%", "more", 0.5),
    "recall": ("%", "less", 0.5),
    "kappa": ("%", "less", 0.5),
}
SIGMAS: Final = ("within 1 sigma", "within 1.96 sigma")


def tiles(given: Given) -> Iterator[Figure]:
    """The default method and sigma's coverage on classified real tiles."""
    if given.data is None or not (given.data / "linear").is_dir():
        return
    method = ground_tiles.project(GroundSettings().method, cells=True)
    for number, tile in enumerate(ground_tiles.tiles(given.data / "linear", ()), 1):
        found = ground_tiles.figures(tile, method(tile), 0.0)
        yield from chosen(_defined(found), TILES, f"tile {number}: ")
        for way, compared in dtm_quality.by_ways(tile):
            if way in {"squares", "half"}:
                yield from _coverage(compared, f"tile {number}, {way}: ")


def _defined(found: Mapping[str, float]) -> dict[str, float]:
    """Figures without those that a tile has nothing for."""
    return {name: value for name, value in found.items() if np.isfinite(value)}


def _coverage(compared: dtm_quality.Compared, of: str) -> Iterator[Figure]:
    for name, share in zip(SIGMAS, dtm_quality.covered(*compared), strict=True):
        yield figure(f"{of}{name}", share, "%", "either", 1.0)


def sigma(given: Given) -> Iterator[Figure]:
    """Share of the quickstart's terrain that lies within its standard deviations of the truth."""
    yield from _coverage(dtm_quality.of_survey(surveys.quickstart(given)), "quickstart: ")


def flightlines(given: Given) -> Iterator[Figure]:
    """Error of the shift that is found between two flightlines, and its standard deviation."""
    for number, shift in enumerate(strips.SHIFTS[1:3]):
        workflow = strips.survey(shift, given.scratch / f"strips_{number}")
        report = api.run(workflow, workers=0).report
        pair = next(p for p in report.strips if p.second.startswith("00002"))
        name = "shift of " + " ".join(f"{v:g}" for v in shift)
        found = pair.east_m, pair.north_m, pair.up_m
        for axis, one, true in zip(("east", "north", "up"), found, shift, strict=True):
            off = np.nan if one is None else 100 * abs(one - true)
            tolerance = 0.1 if axis == "up" else 0.5
            yield figure(f"{name}: error of {axis}", off, "cm", "more", tolerance)
        spread = np.nan if pair.up_sd_m is None else 100 * pair.up_sd_m
        yield figure(f"{name}: standard deviation of up", spread, "cm", "more", 0.1)


EXTENT_M: Final = 80.0


def reflectance(given: Given) -> Iterator[Figure]:
    """Intensity against true reflectance, over patches and cells."""
    scene = intensity.intensity_scene(SEED, EXTENT_M)
    survey = make_survey(scene, given.scratch / "intensity")
    surveys.run(survey / "workflow.yaml")
    found, _ = intensity.estimates(survey, scene)
    truth = intensity.raster(survey / "truth" / "reflectance.tif")
    patch = intensity.patches(survey, scene)
    made = found["delivered"]
    by_patch = intensity.scores(intensity.means(made, patch), intensity.means(truth, patch))
    by_cell = intensity.scores(made[patch > 0], truth[patch > 0])
    for name, (squared, about, ratio) in (("patches", by_patch), ("cells", by_cell)):
        yield figure(f"{name}: squared correlation", squared, "", "less", 0.005)
        yield figure(f"{name}: R2 about the 1:1 line", about, "", "less", 0.005)
        yield figure(f"{name}: median ratio", ratio, "", "either", 0.01)
