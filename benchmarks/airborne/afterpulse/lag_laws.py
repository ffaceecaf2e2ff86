"""Afterpulses and ranging noise that are not what the sensor states: what is lost, what stays.

Run ``python -m benchmarks.airborne.afterpulse.lag_laws [FOLDER] [--only WORD]``.

Each row is a small scene whose detector has lags with a long tail, more or fewer afterpulses, more
ranging noise, or range walk, or whose files do not number the beamlets; the workflow knows the
preset alone. The same scene without afterpulses gives the terrain to compare with. *Stated* has the
law and the ranging noise that the sensor states, as flightlines without a hard surface have, and no
beamlets but by number; *shown* is what runs by default. FOLDER keeps the surveys (a temporary one
by default).
"""

import argparse
import contextlib
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final
from unittest import mock

import laspy
import numpy as np
import pyarrow.parquet as pq
import rasterio
from numpy.typing import NDArray

from benchmarks.airborne.afterpulse.afterpulse_scenes import FLIGHTS
from benchmarks.airborne.filter import methods
from spl_batch import api
from spl_batch.airborne.afterpulse import afterpulse_law
from spl_batch.airborne.sensors.sensor import Sensor
from spl_batch.airborne.simulate import simulate
from spl_batch.airborne.simulate.scene.scene_file import parse_scene
from spl_batch.airborne.tasks import lines_of_sight

KINDS: Final = (*methods.KINDS, "bottom")
GROUND, ROOF, VEGETATION, AFTERPULSE = (
    KINDS.index(name) for name in ("ground", "roof", "vegetation", "afterpulse")
)

EXTENT_M: Final = 70
"""Edge of a scene [m]."""

OFF_M: Final = 0.5
"""Cells whose terrain is off by more are counted [m]."""


def power(p: float, longest_m: float = 15.0) -> dict[str, Any]:
    """Lags that fall as a power of themselves."""
    return {"afterpulse_probability": p, "afterpulse_lag_max_m": longest_m,
            "tail": {"share": 1.0, "scale_m": 0.5, "power": 1.5}}  # fmt: skip


def double(p: float, longest_m: float = 15.0) -> dict[str, Any]:
    """Lags of two exponentials, four in ten of 4 m."""
    return {"afterpulse_probability": p, "afterpulse_lag_max_m": longest_m,
            "tail": {"share": 0.4, "scale_m": 4.0}}  # fmt: skip


ROWS: Final[dict[str, dict[str, Any]]] = {
    "the preset's": {},
    "power law, 0.25, 15 m": power(0.25),
    "power law, 0.12, 15 m": power(0.12),
    "power law, 0.25, 8 m": power(0.25, 8.0),
    "power law, 0.50, 15 m": power(0.5),
    "power law, 0.25, 30 m": power(0.25, 30.0),
    "two exponentials, 0.25, 15 m": double(0.25),
    "two exponentials, 0.12, 15 m": double(0.12),
    "two exponentials, 0.50, 15 m": double(0.5),
    "scale 0.3 m, 0.25": {"afterpulse_probability": 0.25, "afterpulse_scale_m": 0.3},
    "ranging noise 7.5 cm": {"range_sigma_m": 0.075},
    "ranging noise 15 cm": {"range_sigma_m": 0.15},
    "ranging noise 30 cm": {"range_sigma_m": 0.3},
    "range walk 10 cm": {"range_walk_m": 0.1},
    "no channel numbers": {},
}
"""What the detector does in each row."""

OVERRIDES: Final = {"no channel numbers": ("survey.channel_dimension=null",)}
"""What the workflow is told in some rows."""


def content(detector: Mapping[str, Any], seed: int = 5) -> dict[str, Any]:
    """A scene of 70 m with two roofs and some trees."""
    return {
        "name": "lags",
        "extent_m": [EXTENT_M, EXTENT_M],
        "seed": seed,
        "terrain": {"relief_m": 6},
        "buildings": {"list": [
            {"centre_m": [18, 20], "size_m": [18, 12], "heading_deg": 20, "roof": "gable"},
            {"centre_m": [50, 48], "size_m": [14, 12], "roof": "flat"}]},
        "trees": {"cover": 0.15},
        "flights": FLIGHTS,
        "sky": {"background_per_m3": 0.08},
        "acquisition": {"prf_hz": 30_000, "gate_m": 150},
        "detector": dict(detector),
    }  # fmt: skip


@contextlib.contextmanager
def as_stated() -> Iterator[None]:
    """Flightlines have the law and the noise of the sensor, and the beamlets that files number."""

    def stated(parts: Any, noise_per_m: float, sensor: Sensor) -> afterpulse_law.AfterpulseLaw:
        del parts, noise_per_m
        return afterpulse_law.sensor_law(sensor)

    with (
        mock.patch.object(afterpulse_law, "fit", stated),
        mock.patch.object(lines_of_sight, "tells_beamlets", return_value=False),
    ):
        yield


def run(survey: Path, name: str, told: Sequence[str] = ()) -> tuple[Path, list[str]]:
    """Run the chain on a survey; its output and what it warns of."""
    overrides = [f"output={name}", "reference=null", *told]
    result = api.run(survey / "workflow.yaml", overrides=overrides, workers=0)
    if result.exit_status:
        raise SystemExit(f"{survey}: the run failed; see {name}/log.jsonl")
    return survey / name, [one.sentence for one in result.report.findings]


def made(detector: Mapping[str, Any], folder: Path) -> Path:
    """The survey of a row, simulated unless it is there."""
    if not (folder / "workflow.yaml").exists():
        simulate(parse_scene(content(detector), "lags"), folder)
    return folder


def figures(survey: Path, out: Path, without: Path) -> dict[str, float]:
    """What went and what stayed, and the terrain against that without afterpulses."""
    kind, parent, label = _labels(survey, out)
    hard = (kind == AFTERPULSE) & np.isin(parent, (GROUND, ROOF))
    surface = np.isin(kind, (GROUND, ROOF))
    terrain = _terrain(out)
    off = terrain - _terrain(without)
    off = off[np.isfinite(off)].astype(np.float64)
    with rasterio.open(survey / "truth" / "dtm.tif") as source:
        true = terrain[::-1] - _fitted(source.read(1)[::-1], terrain.shape)
    gone = label[hard] != 0
    return {
        "removed %": 100 * float(gone.mean()) if hard.any() else np.nan,
        "hard kept %": 100 * float((label[surface] == 0).mean()),
        "trees kept %": 100 * float((label[kind == VEGETATION] == 0).mean()),
        "DTM RMSE cm": 100 * float(np.sqrt(np.mean(off**2))),
        "DTM mean cm": 100 * float(off.mean()),
        "- true cm": 100 * float(np.nanmedian(true)),
        f"> {OFF_M} m %": 100 * float(np.mean(np.abs(off) > OFF_M)),
    }


def _labels(survey: Path, out: Path) -> tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[Any]]:
    """Kind and parent by truth, and what the run says of each return."""
    found: list[list[NDArray[Any]]] = [[], [], []]
    for path in sorted((survey / "truth").glob("line_*.parquet")):
        truth = pq.read_table(path)
        las = laspy.read(out / "laz" / "flightlines" / f"{path.stem}.laz")
        columns = (truth["kind"].to_numpy(), truth["parent"].to_numpy(), las["noise_class"])
        for part, values in zip(found, columns, strict=True):
            part.append(np.asarray(values))
    kind, parent, label = map(np.concatenate, found)
    return kind, parent, label


def _fitted(true: NDArray[np.float32], shape: tuple[int, ...]) -> NDArray[np.float32]:
    """True heights in as many cells as a raster has, the nearest for each."""
    row, column = (np.arange(n) * m // n for n, m in zip(shape, true.shape, strict=True))
    return true[np.ix_(row, column)]


def _terrain(out: Path) -> NDArray[np.float32]:
    """Heights of the scene's own cells, NaN where there is none."""
    west, south = parse_scene(content({}), "lags").origin_m[:2]
    east, north = west + EXTENT_M, south + EXTENT_M
    with rasterio.open(out / "dtm.tif") as source:
        window = source.window(west, south, east, north).round_offsets().round_lengths()
        values = source.read(1, window=window, boundless=True, fill_value=-9999)
    return np.where(values > -9000, values, np.float32(np.nan))


def table(folder: Path, rows: Sequence[str], *, stated: bool = True) -> list[dict[str, float]]:
    """Print the rows; the figures of what runs by default."""
    found: list[dict[str, float]] = []
    for number, name in enumerate(rows):
        detector = ROWS[name]
        place = folder / name.replace(" ", "_").replace(",", "").replace("'", "")
        survey = made(detector, place)
        plain = made({**detector, "afterpulse_probability": 0.0}, place / "without")
        without, _ = run(plain, "out")
        for how in ("stated", "shown") if stated else ("shown",):
            with as_stated() if how == "stated" else contextlib.nullcontext():
                out, said = run(survey, f"out_{how}", OVERRIDES.get(name, ()))
            values = figures(survey, out, without)
            if number == 0 and not found:
                heads = "".join(f"{head:>14s}" for head in values)
                print(f"{'detector':36s}{heads}  warnings")
            print(f"{name + ', ' + how:36s}" + "".join(f"{v:14.2f}" for v in values.values())
                  + f"  {len(said)}", flush=True)  # fmt: skip
        for text in said:
            print(f"    {text}")
        found.append(values)
    return found


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description="Afterpulses and noise that nobody stated.")
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--only", default="", help="rows whose name holds this")
    parser.add_argument("--shown", action="store_true", help="leave out what the sensor states")
    given = parser.parse_args()
    rows = [name for name in ROWS if given.only in name]
    if given.folder:
        table(given.folder, rows, stated=not given.shown)
    else:
        with tempfile.TemporaryDirectory() as temporary:
            table(Path(temporary), rows, stated=not given.shown)


if __name__ == "__main__":
    main()
