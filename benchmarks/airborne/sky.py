"""What a real sky and stray light do to the result, and whether the run says so.

Run ``python -m benchmarks.airborne.sky [FOLDER] [--only NAME ...] [--times 0.5 1 2]``.

Each row is a small survey with one effect that the model of the noise does not know, run with the
default settings. ``far noise`` is noise more than 3 m from every true return. A DSM cell is too
high where it stands above every true return of it and the cells around. ``told`` counts the
warnings that the same scene without the effect does not have; ``--say`` prints them. An effect is
``held`` where no figure is worse than that of the base by more than :data:`HELD` allows, else it is
``told`` or ``SILENT``.
"""

import argparse
import json
import math
import re
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pyarrow.parquet as pq
import rasterio
from affine import Affine
from numpy.typing import NDArray
from scipy.spatial import KDTree

from benchmarks.airborne.filter.methods import KINDS, is_noise
from spl_batch.airborne.simulate import simulate
from spl_batch.airborne.simulate.scene.scene_file import parse_scene
from spl_batch.airborne.simulate.survey import KINDS as ALL_KINDS
from spl_batch.engine.verbs.running import run

BASE: dict[str, Any] = {
    "name": "base",
    "extent_m": [110, 110],
    "seed": 11,
    "terrain": {"relief_m": 8, "wavelength_m": 100},
    "buildings": {"count": 3},
    "trees": {"cover": 0.25},
    "wires": [
        {"kind": "transmission", "points_m": [[-60, 75], [170, 95]], "height_m": 24, "sag_m": 4,
         "returns_per_m": 0.8},
    ],
    "flights": [
        {"heading_deg": 0, "offset_m": 300, "speed_m_s": 110},
        {"heading_deg": 90, "offset_m": -280, "speed_m_s": 110},
    ],
    "sky": {"background_per_m3": 0.05},
    "acquisition": {"prf_hz": 25_000, "gate_m": 250},
}  # fmt: skip

_NUMBER = re.compile(r"[\d\s.,]*\d")

FAR_M = 3.0
"""Distance from true returns from which on noise is far [m]."""


def haze(times: float, base_m: float, top_m: float, cover: float = 0.5) -> dict[str, Any]:
    """A layer in patches that drift."""
    layer = {"base_m": base_m, "top_m": top_m, "times_noise": times, "cover": cover,
             "patch_m": 60, "drift_m_s": [3, 1]}  # fmt: skip
    return {"sky": {"haze": [layer]}}


def small_patches(times: float) -> dict[str, Any]:
    """The same in patches half as large that drift faster."""
    (layer,) = haze(50 * times, 30, 50, 0.4)["sky"]["haze"]
    return {"sky": {"haze": [{**layer, "patch_m": 30, "drift_m_s": [4, -2]}]}}


def reflectors(count: float) -> dict[str, Any]:
    """Retro-reflectors here and there, some on poles."""
    rng = np.random.default_rng(5)
    places = rng.uniform(10, 100, (max(round(count), 1), 2))
    return {"reflectors": [
        {"place_m": list(map(float, place)), "height_m": float(1 + 1.5 * (k % 4)), "electrons": 5}
        for k, place in enumerate(places)
    ]}  # fmt: skip


def tail(times: float) -> dict[str, Any]:
    """One return in four is followed by an afterpulse, some of them late by a power law."""
    late = {"share": min(0.4 * times, 1.0), "scale_m": 2.0, "power": 2.0}
    return {"detector": {"afterpulse_probability": 0.25, "afterpulse_lag_max_m": 15, "tail": late}}


def apart(times: float) -> dict[str, Any]:
    """The second flightline is recorded off."""
    first, second = BASE["flights"]
    return {"flights": [first, {**second, "strip_offset_m": [0.3 * times, 0, 0.2 * times]}]}


def dark_lake(times: float) -> dict[str, Any]:
    """A lake that hardly sends anything back."""
    ring = [[20, 15], [80, 15], [80, 60], [20, 60]]
    return {"water": [{"ring_m": ring, "reflectance": 0.002 / times}]}


def two_clouds(times: float) -> dict[str, Any]:
    """Two layers of patches, one above the other."""
    layers = [
        {**layer, "patch_m": patch_m, "drift_m_s": [4, -2]}
        for patch_m, of in (
            (50, haze(25 * times, 40, 55, 0.6)),
            (80, haze(15 * times, 80, 100, 0.7)),
        )
        for layer in of["sky"]["haze"]
    ]
    return {"sky": {"haze": layers}}


def long_lags(times: float) -> dict[str, Any]:
    """Most afterpulses come late, by a power law that hardly ends."""
    late = {"share": min(0.6 * times, 1.0), "scale_m": 1.0, "power": 1.3}
    return {"detector": {"afterpulse_probability": 0.2, "afterpulse_lag_max_m": 40, "tail": late}}


def city(times: float) -> dict[str, Any]:
    """High houses in fog."""
    return {"buildings": {"count": 14, "eave_m": [20, 60]}, "trees": {"cover": 0.05},
            "sky": {"fog": [{"times_noise": 40 * times, "scale_m": 3}]}}  # fmt: skip


def unlike(**second: Any) -> dict[str, Any]:
    """The second flightline is unlike the first."""
    first, usual = BASE["flights"]
    return {"flights": [first, {**usual, **second}]}


def snow(_: float) -> dict[str, Any]:
    """Bright ground, and a lake with waves."""
    ring = [[20, 15], [80, 15], [80, 60], [20, 60]]
    return {"terrain": {"reflectance": 0.8}, "water": [{"ring_m": ring, "waves_m": 0.3}]}


EFFECTS: dict[str, Any] = {
    "base": lambda _: {},
    "by tile, no ids": lambda _: {"delivery": {"tile_m": 40, "point_source_id": False}},
    "no channel numbers": lambda _: {},
    "haze 60-100 m, 5 x": lambda t: haze(5 * t, 60, 100),
    "haze 60-100 m, 20 x": lambda t: haze(20 * t, 60, 100),
    "haze 25-45 m, 30 x": lambda t: haze(30 * t, 25, 45),
    "closed cloud 70-110 m, 20 x": lambda t: haze(20 * t, 70, 110, 1.0),
    "fog, 1.5 m, 60 x": lambda t: {"sky": {"fog": [{"times_noise": 60 * t, "scale_m": 1.5}]}},
    "noise falls along the gate": lambda t: {"sky": {"gate_fall": 0.4 * t}},
    "12 reflectors": lambda t: reflectors(12 * t),
    "crosstalk 5 %": lambda t: {"acquisition": {"crosstalk": 0.05 * t}},
    "afterpulses, tail of 40 %": tail,
    "ranging noise 15 cm": lambda t: {"detector": {"range_sigma_m": 0.15 * t}},
    "strips 0.3 m east, 0.2 m up": apart,
    "lake, 0.2 % reflected": dark_lake,
    "noise 0.3 per m3": lambda t: {"sky": {"background_per_m3": 0.3 * t}},
    "times rounded to 100 us": lambda t: {"delivery": {"time_step_us": 100 * t}},
    "haze 30-50 m, 50 x": small_patches,
    "thin haze 20-30 m, 30 x": lambda t: haze(30 * t, 20, 30, 0.7),
    "thinner haze 8-14 m, 20 x": lambda t: haze(20 * t, 8, 14),
    "two clouds": two_clouds,
    "long lags": long_lags,
    "boresight roll 0.02 deg": lambda t: unlike(boresight_roll_deg=0.02 * t),
    "range walk 0.3 m": lambda t: {"detector": {"range_walk_m": 0.3 * t}},
    "city in fog": city,
    "second gate 350 m": lambda _: unlike(gate_m=350),
    "second file in another CRS": lambda _: unlike(crs="EPSG:32616"),
    "second line from 1800 m": lambda _: unlike(altitude_agl_m=1800),
    "both lines from 1800 m": lambda _: {
        "flights": [{**flight, "altitude_agl_m": 1800} for flight in BASE["flights"]]
    },
    "snow, waves": snow,
    "cm, us, user_data": lambda _: {
        "delivery": {"channel_dimension": "user_data", "scale_m": 0.01, "time_step_us": 1}
    },
}
"""Effects by name: what strength makes of the base."""

ONCE: tuple[str, ...] = (
    "base", "by tile, no ids", "no channel numbers", "second gate 350 m",
    "second file in another CRS", "second line from 1800 m", "both lines from 1800 m",
    "snow, waves", "cm, us, user_data",
)  # fmt: skip
"""Those that have no strength."""

SETTINGS: dict[str, list[str]] = {"no channel numbers": ["survey.channel_dimension=null"]}
"""Settings that an effect is run with."""

HELD: dict[str, float] = {
    "noise removed": -1.0, "far noise kept": 0.2, "afterpulses": -3.0, "ground": -0.5,
    "roof": -1.0, "vegetation": -1.0, "wire": -2.0, "DSM > 1 m": 0.3, "DTM rmse": 0.03,
}  # fmt: skip
"""By how much a figure may be higher, or lower, than the base's [%, m]."""


def scene(name: str, times: float) -> dict[str, Any]:
    """Content of a scene file."""
    merged = {k: dict(v) if isinstance(v, dict) else v for k, v in BASE.items()}
    for key, value in EFFECTS[name](times).items():
        merged[key] = {**merged.get(key, {}), **value} if isinstance(value, dict) else value
    return merged | {"name": f"{name}, {times:g}"}


def measure(folder: Path) -> dict[str, float]:
    """Figures of one processed survey [%, m]."""
    points = _load(folder)
    kind, kept = points["kind"], points["noise_class"] == 0
    noise = is_noise(kind)
    xyz = np.column_stack([points[axis] for axis in "xyz"])
    gap = KDTree(xyz[~noise]).query(xyz[noise], distance_upper_bound=FAR_M, workers=2)[0]
    far = np.isinf(gap)
    figures = {
        "noise removed": 100 * float(1 - kept[noise].mean()),
        "far noise kept": 100 * float(kept[noise][far].mean()),
    }
    late = kind == KINDS.index("afterpulse")
    figures["afterpulses"] = 100 * float(1 - kept[late].mean())
    for name in ("ground", "roof", "vegetation", "wire"):
        figures[name] = 100 * float(kept[kind == KINDS.index(name)].mean())
    return figures | _surfaces(folder, points, noise)


def _load(folder: Path) -> dict[str, NDArray[Any]]:
    parts: dict[str, list[NDArray[Any]]] = {}
    for path in sorted((folder / "out" / "laz").rglob("*.laz")):
        las, truth = laspy.read(path), folder / "truth" / f"{path.stem}.parquet"
        parts.setdefault("kind", []).append(pq.read_table(truth)["kind"].to_numpy())
        for name in ("x", "y", "z", "noise_class"):
            parts.setdefault(name, []).append(np.asarray(las[name]))
    return {name: np.concatenate(values) for name, values in parts.items()}


def _surfaces(
    folder: Path, points: dict[str, NDArray[Any]], noise: NDArray[np.bool_]
) -> dict[str, float]:
    """How much of the DSM stands above every true return around, and the error of the DTM."""
    with rasterio.open(folder / "truth" / "dtm.tif") as source:
        true, origin = source.read(1).astype(np.float64), source.transform
    dsm, dtm = (
        _on_grid(folder / "out" / f"{name}.tif", origin, true.shape) for name in ("dsm", "dtm")
    )
    row = np.floor((origin.f - points["y"][~noise]) / -origin.e).astype(int)
    col = np.floor((points["x"][~noise] - origin.c) / origin.a).astype(int)
    inside = (row >= 0) & (row < true.shape[0]) & (col >= 0) & (col < true.shape[1])
    top = np.full((true.shape[0] + 2, true.shape[1] + 2), -np.inf)
    np.maximum.at(top, (row[inside] + 1, col[inside] + 1), points["z"][~noise][inside])
    near = np.lib.stride_tricks.sliding_window_view(top, (3, 3)).max(axis=(2, 3))
    over = (dsm - near)[np.isfinite(dsm) & np.isfinite(near)]
    error = (dtm - true)[np.isfinite(dtm) & (true > -9000)]
    return {
        "DSM > 1 m": 100 * float((over > 1).mean()),
        "DSM > 10 m": 100 * float((over > 10).mean()),
        "DSM rmse": math.sqrt(float(np.mean(np.maximum(over, 0) ** 2))),
        "DTM rmse": math.sqrt(float(np.mean(error**2))),
        "DTM > 0.5": 100 * float((np.abs(error) > 0.5).mean()),
    }


def _on_grid(path: Path, origin: Affine, shape: tuple[int, int]) -> NDArray[np.float64]:
    """Part of a raster on the cells of the truth; NaN where it has none."""
    with rasterio.open(path) as source:
        values, at = source.read(1).astype(np.float64), source.transform
    out = np.full(shape, np.nan)
    r0, c0 = round((origin.f - at.f) / -origin.e), round((at.c - origin.c) / at.a)
    rows = slice(max(r0, 0), min(r0 + values.shape[0], shape[0]))
    cols = slice(max(c0, 0), min(c0 + values.shape[1], shape[1]))
    part = values[rows.start - r0 : rows.stop - r0, cols.start - c0 : cols.stop - c0]
    out[rows, cols] = np.where(part > -9000, part, np.nan)
    return out


def main() -> None:
    """Simulate, run, measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--only", nargs="+", choices=list(EFFECTS), default=list(EFFECTS))
    parser.add_argument("--times", nargs="+", type=float, default=[1.0])
    parser.add_argument("--without", action="store_true", help="noise.haze: false")
    parser.add_argument("--bloom", action="store_true", help="noise.bloom: true")
    parser.add_argument("--say", action="store_true", help="print the warnings")
    given = parser.parse_args()
    folder = given.folder or Path(tempfile.mkdtemp())
    settings = ["noise.haze=false"] if given.without else []
    settings += ["noise.bloom=true"] if given.bloom else []
    usual: list[str] = []
    base: dict[str, float] = {}
    for name in dict.fromkeys(("base", *given.only)):
        for times in [1.0] if name in ONCE else given.times:
            survey = folder / f"{name}_{times:g}".replace(" ", "_").replace(",", "")
            if not (survey / "workflow.yaml").exists():
                simulate(parse_scene(scene(name, times), name), survey)
            overrides = [*settings, *SETTINGS.get(name, ())]
            run(survey / "workflow.yaml", workers=0, overrides=overrides)
            figures = measure(survey)
            said = told_by(json.loads((survey / "out" / "report.json").read_text()))
            if name == "base":
                usual, base = said, figures
                print(f"{'':34s}" + "".join(f"{key:>15s}" for key in (*figures, "told")))
            told = new_warnings(said, usual)
            row = "".join(f"{value:15.2f}" for value in figures.values())
            words = verdict(figures, base, len(told))
            print(f"{name:30s}{times:4g}{row}{len(told):15d} {words}", flush=True)
            if name.startswith("crosstalk"):
                print(f"    {crosstalk(survey)}")
            for text in told if given.say else []:
                print(f"    {text}")


def crosstalk(survey: Path) -> str:
    """Returns that others set off: in truth, and in the report [count]."""
    noise = json.loads((survey / "out" / "report.json").read_text())["noise"]
    true = 0
    for path in sorted((survey / "out" / "laz").rglob("*.laz")):
        kind = pq.read_table(survey / "truth" / f"{path.stem}.parquet")["kind"].to_numpy()
        true += int(np.count_nonzero(kind == ALL_KINDS.index("crosstalk")))
    return f"{true} set off, {noise['crosstalk']} counted, {noise['crosstalk_expected']} reckoned"


def told_by(report: dict[str, Any]) -> list[str]:
    """What a report warns of, and why it lacks files."""
    return [*report["warnings"], *(failure["reason"] for failure in report["failures"])]


def new_warnings(said: Iterable[str], usual: Iterable[str]) -> list[str]:
    """Warnings that say something else than the usual ones, not other numbers alone."""
    known = {_NUMBER.sub("", text) for text in usual}
    return [text for text in said if _NUMBER.sub("", text) not in known]


def verdict(figures: dict[str, float], base: dict[str, float], told: int) -> str:
    """Held, told or silent, and the figures that are worse than is held."""
    worse = [
        f"{key} {figures[key] - base[key]:+.2f}"
        for key, most in HELD.items()
        if (figures[key] - base[key]) * math.copysign(1, most) > abs(most)
    ]
    if not worse:
        return "held"
    return f"{'told' if told else 'SILENT'}: {', '.join(worse)}"


if __name__ == "__main__":
    main()
