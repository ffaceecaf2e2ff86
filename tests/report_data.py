"""A believable survey for the report's tests: relief, houses, trees, a wire, and noise."""

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

EXTENT = (500_000.0, 500_400.0, 3_300_000.0, 3_300_300.0)


def make_finding(count: int) -> Finding:
    """A trajectory that ends too early."""
    values = {"kind": "uncovered", "count": count, "first_s": 1.0, "last_s": 3.1}
    return Finding("T02", values, "00003_1000")


def statistics(differences: NDArray[Any]) -> Statistics:
    median = np.median(differences)
    return Statistics(
        n=differences.size,
        mean=differences.mean(),
        median=median,
        rmse=np.sqrt(np.mean(differences**2)),
        sd=differences.std(),
        nmad=1.4826 * np.median(np.abs(differences - median)),
        p95=np.percentile(np.abs(differences), 95),
        min=differences.min(),
        max=differences.max(),
    )


def terrain(x: NDArray[Any], y: NDArray[Any]) -> NDArray[Any]:
    hills = 6 * np.sin(x / 71) * np.cos(y / 53) + 0.04 * x
    bank = 3.0 / (1 + np.exp(-(y - 150 - 25 * np.sin(x / 60)) / 4))
    return 52 + hills + bank


@cache
def make_inputs() -> dict[str, Any]:
    """Arguments of the pictures of a report."""
    rows, columns = 300, 400
    rng = np.random.default_rng(20_260)
    x, y = np.meshgrid(np.arange(columns) + 0.5, rows - np.arange(rows) - 0.5)
    ground = terrain(x, y)
    dsm = ground + np.abs(rng.normal(0, 0.04, ground.shape))
    for west, south, wide, deep, high in (
        (40, 40, 30, 18, 6.0),
        (100, 50, 22, 26, 8.5),
        (220, 60, 45, 20, 5.5),
        (300, 210, 24, 24, 11.0),
        (60, 220, 36, 16, 7.0),
    ):
        inside = (x > west) & (x < west + wide) & (y > south) & (y < south + deep)
        ridge = high + 2.2 - 0.35 * np.abs(y - south - deep / 2)
        dsm[inside] = (ground + ridge)[inside]
    for _ in range(160):
        cx, cy = rng.uniform(0, columns), rng.uniform(100, 220)
        radius, high = rng.uniform(2, 6), rng.uniform(4, 18)
        crown = high * (1 - ((x - cx) ** 2 + (y - cy) ** 2) / radius**2)
        crown += rng.normal(0, 0.5, crown.shape)
        dsm = np.maximum(dsm, ground + np.where(crown > 0, crown, 0))
    void = (x - 350) ** 2 / 900 + (y - 40) ** 2 / 300 < 1
    difference = rng.normal(0.008, 0.035, ground.shape) + 0.03 * np.sin(x / 40)
    difference[dsm - ground > 2] += np.abs(rng.normal(0, 0.12, (dsm - ground > 2).sum()))
    dtm = np.where(void, -9999.0, ground)
    noise = 0.05 + 0.07 / (1 + np.exp(-(x[::10, ::10] - 160) / 12)) + 0.0001 * y[::10, ::10]
    density = 14 + 9 * (np.abs((y % 120) - 60) < 25) + rng.poisson(6, ground.shape)
    rasters = {
        "dtm": dtm.astype(np.float32),
        "dsm": np.where(void, np.nan, dsm),
        "chm": np.where(void, -9999.0, dsm - ground),
        "dtm_quality": np.where(void, -9999.0, 0.03 + 0.001 * density),
        "density": np.where(void, -9999.0, density),
        "difference": np.where(void, -9999.0, difference),
        "noise_density": noise,
        "strips": 0.05 + 0.0001 * x[::20, ::20],
    }
    return {
        "rasters": {name: Raster(values, EXTENT) for name, values in rasters.items()},
        "differences_m": difference[~void],
        "profile": make_profile(rng),
    }


def make_profile(rng: np.random.Generator) -> Profile:
    def surface(along: NDArray[Any]) -> NDArray[Any]:
        return terrain(along + 30, np.full_like(along, 60.0))

    parts = []
    along = rng.uniform(0, 100, 2600)
    parts.append((along, surface(along) + rng.normal(0, 0.05, along.size), 0, 2))
    roof = rng.uniform(22, 44, 900)
    parts.append((roof, surface(roof) + 9 - 0.3 * abs(roof - 33) + rng.normal(0, 0.05, 900), 0, 6))
    after = roof[:150]
    lag = 0.3 + rng.exponential(0.7, 150)
    parts.append((after, surface(after) + 9 - 0.3 * abs(after - 33) - lag, 2, 1))
    tree = rng.normal(70, 3, 1500)
    parts.append((tree, surface(tree) + 11 * rng.beta(2, 1.4, 1500), 0, 1))
    wire = rng.uniform(0, 100, 130)
    parts.append((wire, 76 + 0.0022 * (wire - 50) ** 2 + rng.normal(0, 0.05, 130), 0, 1))
    noise = rng.uniform(0, 100, 8000)
    parts.append((noise, rng.uniform(-60, 240, 8000), 1, 7))
    return Profile(
        along_m=np.concatenate([p[0] for p in parts]),
        z_m=np.concatenate([p[1] for p in parts]),
        noise_class=np.concatenate([np.full(len(p[0]), p[2], np.uint8) for p in parts]),
        classification=np.concatenate([np.full(len(p[0]), p[3], np.uint8) for p in parts]),
        width_m=2.5,
    )


@cache
def make_accuracy() -> Accuracy:
    rng = np.random.default_rng(7)
    seen = make_inputs()["differences_m"]
    return Accuracy(
        dtm={
            "all": statistics(seen),
            "open_ground": statistics(rng.normal(0.008, 0.04, 58_211)),
            "under_canopy": statistics(rng.normal(0.05, 0.11, 31_377)),
        },
        dsm={
            "all": statistics(rng.normal(-0.11, 0.9, 98_771)),
            "roof": statistics(rng.normal(0.01, 0.06, 8_820)),
            "canopy": statistics(rng.normal(-0.4, 1.7, 30_551)),
        },
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
        "shots": (38.4, 12, 293_852.0, 802.0),
        "shuffle": (16.9, 12, 667_694.0, 655.0),
        "denoise": (61.7, 12, 182_885.0, 1_410.0),
        "ground": (33.2, 6, 339_880.0, 1_122.0),
        "surfaces": (12.6, 12, 895_558.0, 640.0),
        "deliver": (24.0, 4, 470_168.0, 520.0),
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
        "findings": reported([make_finding(118_402)]),
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
