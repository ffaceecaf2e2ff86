"""Groups of figures that must hold: what measures each."""

from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType
from typing import Final

from benchmarks import quality
from benchmarks.held import labels, noise, receivers, speed, surveys, terrain, tiles
from benchmarks.held.figures import Figure, Moves, chosen
from benchmarks.held.surveys import Given


def hashes(given: Given) -> Iterator[Figure]:
    """Labels and rasters of the quickstart, and of two flightlines."""
    yield from surveys.hashes(surveys.quickstart(given) / "out", "quickstart")
    yield from surveys.hashes(surveys.in_sky(given, "base") / "out", "two lines")


def plots(given: Given) -> Iterator[Figure]:
    """Labels and rasters of real plots."""
    for number, cloud in enumerate(given.real("spl/*.la[sz]"), 1):
        out = surveys.of_cloud(cloud, surveys.PHOTON_COUNTING, given.scratch / cloud.stem)
        yield from surveys.hashes(out, f"plot {number}")


QUALITY: Final[Moves] = {
    "ground labelled signal %": ("%", "less", 0.05),
    "roof labelled signal %": ("%", "less", 0.1),
    "vegetation labelled signal %": ("%", "less", 0.2),
    "wire labelled signal %": ("%", "less", 0.5),
    "water labelled signal %": ("%", "less", 0.5),
    "bottom labelled signal %": ("%", "less", 1.0),
    "water in its polygon of class 9 %": ("%", "less", 0.5),
    "bottom in its polygon of class 1 %": ("%", "less", 1.0),
    "background removed %": ("%", "less", 0.2),
    "afterpulses under ground and roofs removed %": ("%", "less", 0.2),
    "afterpulses in vegetation removed %": ("%", "less", 1.0),
    "DTM RMSE on open ground cm": ("cm", "more", 0.1),
    "DTM mean |difference| everywhere cm": ("cm", "more", 0.2),
    "DTM worst difference cm": ("cm", "more", 10.0),
    "DTM RMSE within water cm": ("cm", "more", 0.5),
    "DSM cells set by noise per 10 000": ("1e-4", "more", 0.5),
    "DSM cells above their own returns per 10 000": ("1e-4", "more", 5.0),
    "expected / true noise density": ("", "either", 0.005),
}


def readme(given: Given) -> Iterator[Figure]:
    """README's table of quality, of the quickstart's survey."""
    yield from chosen(quality.figures(surveys.quickstart(given)), QUALITY)


GROUPS: Final[Mapping[str, Callable[[Given], Iterator[Figure]]]] = MappingProxyType(
    {
        "hashes": hashes,
        "plots": plots,
        "readme": readme,
        "sigma": terrain.sigma,
        "isprs": tiles.samples,
        "tiles": tiles.tiles,
        "tracks": receivers.tracks,
        "labelled": receivers.labelled,
        "water": receivers.surface,
        "coincidence": receivers.coincidence,
        "strips": terrain.flightlines,
        "intensity": terrain.reflectance,
        "alpha": noise.alpha,
        "haze": labels.haze,
        "wires": labels.conductors,
        "afterpulse": labels.afterpulse,
        "noise": noise.strata,
        "uneven": noise.kept,
        "ground": terrain.ground,
        "stages": speed.stages,
        "kernels": speed.kernels,
    }
)
"""What measures each group, in the order of a run."""
