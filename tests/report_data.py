"""A survey for the report's tests: relief, houses, and a profile of everything."""

import io
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from spl_batch.airborne.report.model import (
    Accuracy,
    Counts,
    Density,
    Flightline,
    Noise,
    Report,
    Survey,
)
from spl_batch.airborne.report.pictures import Profile, Raster
from spl_batch.engine.findings import Finding
from spl_batch.engine.report import style
from spl_batch.engine.report.parts import (
    Failure,
    InputFile,
    Performance,
    Provenance,
    StagePerformance,
    Statistics,
)
from spl_batch.engine.report.reported import reported
from spl_batch.numerics.error_statistics import statistics

EXTENT = (500_000.0, 500_400.0, 3_300_000.0, 3_300_300.0)
UNCOVERED = {"kind": "uncovered", "count": 118_402, "first_s": 1.0, "last_s": 3.1}
"""Of a trajectory that ends too early."""


def terrain(x: NDArray[Any], y: NDArray[Any]) -> NDArray[Any]:
    hills: NDArray[Any] = 52 + 6 * np.sin(x / 71) * np.cos(y / 53) + 0.04 * x
    return hills


@cache
def make_inputs() -> dict[str, Any]:
    """Arguments of the pictures of a report."""
    rng = np.random.default_rng(20_260)
    x, y = np.meshgrid(np.arange(400) + 0.5, 300 - np.arange(300) - 0.5)
    void = (x - 350) ** 2 / 900 + (y - 40) ** 2 / 300 < 1
    ground, height = terrain(x, y), 9.0 * ((x // 20 + y // 20) % 3 == 0)
    density = 14.0 + rng.poisson(6, x.shape)
    difference = rng.normal(0.008, 0.035, x.shape) + 0.03 * np.sin(x / 40)
    known = {
        "dtm": ground,
        "chm": height,
        "dtm_quality": 0.03 + 0.001 * density,
        "density": density,
        "difference": difference,
    }
    rasters = {
        **{name: np.where(void, -9999.0, values) for name, values in known.items()},
        "dsm": np.where(void, np.nan, ground + height),
        "noise_density": 0.05 + 0.0002 * x[::10, ::10],
        "strips": 0.05 + 0.0001 * x[::20, ::20],
    }
    return {
        "rasters": {name: Raster(values, EXTENT) for name, values in rasters.items()},
        "differences_m": difference[~void],
        "profile": make_profile(rng),
    }


def make_profile(rng: np.random.Generator) -> Profile:
    """Ground, a roof, its afterpulses, trees and noise: number, greatest height, and classes."""
    kinds = np.array(
        [(2600, 0.1, 0, 2), (900, 9.0, 0, 6), (150, 8.0, 2, 1), (1500, 11, 0, 1), (8000, 240, 1, 7)]
    )
    count = kinds[:, 0].astype(int)
    high, noise_class, classification = np.repeat(kinds[:, 1:], count, axis=0).T
    along = rng.uniform(0, 100, count.sum())
    return Profile(
        along_m=along,
        z_m=terrain(along + 30, np.full_like(along, 60.0)) + high * rng.random(count.sum()),
        noise_class=noise_class.astype(np.uint8),
        classification=classification.astype(np.uint8),
        width_m=2.5,
    )


@cache
def make_accuracy() -> Accuracy:
    rng = np.random.default_rng(7)

    def of(mean_m: float, sd_m: float, n: int) -> Statistics:
        return Statistics(**statistics(rng.normal(mean_m, sd_m, n)))

    return Accuracy(
        dtm={
            "all": Statistics(**statistics(make_inputs()["differences_m"])),
            "open_ground": of(0.008, 0.04, 58_211),
            "under_canopy": of(0.05, 0.11, 31_377),
        },
        dsm={"all": of(-0.11, 0.9, 98_771), "roof": of(0.01, 0.06, 8_820)},
        reference_points=1_204_551,
        bias_m=0.011,
    )


def make_report(**changes: Any) -> Report:
    lines = tuple(
        Flightline(
            id=str(number),
            points=points,
            shots=points // 30,
            start_s=271_000.0 + 300 * number,
            end_s=271_000.0 + 300 * number + 41.27,
            prf_hz=60_000.0,
            prf_basis="given",
            gate_m=300.0 - 3 * number,
            gate_basis="estimated",
            beam_basis="trajectory" if number < 3 else "scan_angle",
            seen_fraction=0.28 + 0.02 * number,
            noise_per_m=0.00012 * number,
        )
        for number, points in ((1, 3_904_112), (2, 3_711_034), (3, 3_668_887))
    )
    stages = {
        "index": (3.1, 3, 3_640_000.0, 210.0),
        "denoise": (61.7, 12, 182_885.0, 1_410.0),
        "report": (6.2, 1, None, 488.0),
    }
    values: dict[str, Any] = {
        "survey": Survey(
            name="Lufkin demonstration",
            crs="EPSG:32615",
            crs_name="WGS 84 / UTM zone 15N",
            sensor="Leica SPL100",
            area_km2=0.12,
            extent_m=EXTENT,
            cell_m=1.0,
            flightlines=lines,
        ),
        "counts": Counts(
            points_in=11_284_033,
            points_out=11_284_033,
            signal=7_012_655,
            background=3_894_201,
            afterpulse=361_040,
            not_assessed=16_137,
            ground=2_977_310,
            building=610_022,
            withheld=12_004,
            vendor_flagged=4_133,
        ),
        "accuracy": make_accuracy(),
        "density": Density(
            mean_per_m2=58.4,
            median_per_m2=56.0,
            p05_per_m2=21.0,
            ground_per_m2=24.8,
            void_share=0.004,
            unsure_share=0.01,
        ),
        "noise": Noise(
            method="vsaes",
            test="calibrated",
            alpha=0.001,
            mean_per_m3=0.0931,
            p05_per_m3=0.051,
            p95_per_m3=0.134,
            dsm_support=2,
        ),
        "performance": Performance(
            wall_s=104.3,
            points_per_s=108_188.0,
            peak_rss_mb=1_410.0,
            workers=2,
            stages={
                name: StagePerformance(wall_s=w, tasks=t, points_per_s=p, peak_rss_mb=m)
                for name, (w, t, p, m) in stages.items()
            },
        ),
        "findings": reported([Finding("T02", UNCOVERED, "00003_1000")]),
        "provenance": Provenance(
            version="0.1.0",
            created="2026-05-04T06:12:44+00:00",
            command="spl-batch run lufkin.yaml --workers 2",
            python="3.11.9",
            platform="Linux x86_64",
            libraries={"numpy": "2.4.0", "numba": "0.68.0", "laspy": "2.7.0"},
            parameters={"filter": {"method": "vsaes", "alpha": 0.001}, "ground": {"method": "ptd"}},
            inputs=tuple(
                InputFile(
                    path=f"flightlines/line_{n}.laz",
                    size=38_000_000 + n,
                    hash="sha256:" + f"{n:x}" * 64,
                    points=line.points,
                )
                for n, line in enumerate(lines, 1)
            ),
        ),
    }
    return Report(**{**values, **changes})


def smallest_report() -> Report:
    """A report of nothing."""
    return Report(
        survey=Survey(name="nothing"),
        counts=Counts(points_in=0, points_out=0),
        provenance=Provenance(version="0", created="2026-01-01T00:00:00+00:00"),
    )


def make_failures() -> tuple[Failure, ...]:
    return (
        Failure(
            stage="index",
            place="flightlines/line_4.laz",
            reason="truncated: 1 204 113 of 3 500 000 points can be read",
            remedy="copy the file again, then: spl-batch run lufkin.yaml",
        ),
        Failure(stage="ground", place="cell 2501_16502", reason="worker ran out of memory"),
    )


drawn_png = style.to_png
"""The function that draws; where a test looks at pictures it is put back."""


def _empty(drawn: Figure, **_: int) -> tuple[bytes, int, int]:
    width, height = (round(inches * drawn.dpi) for inches in drawn.get_size_inches())
    stream = io.BytesIO()
    Image.new("1", (width, height)).save(stream, format="PNG", compress_level=1)
    return stream.getvalue(), width, height


@contextmanager
def empty_pictures() -> Iterator[None]:
    """Context in which no figure is drawn."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(style, "to_png", _empty)
        yield


@contextmanager
def drawn_pictures() -> Iterator[None]:
    """Context for a fixture whose pictures are looked at."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(style, "to_png", drawn_png)
        yield
