"""Orders that the sources' tables turn on, on twins small enough for tests."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.airborne.filter import methods
from benchmarks.airborne.published import corridors
from benchmarks.airborne.published.corridors import Counts
from benchmarks.airborne.published.table_dcc import kept, load
from benchmarks.airborne.published.twins import easton
from spl_batch.airborne.filter.denoise import METHODS
from spl_batch.airborne.filter.filter_interface import Cloud
from spl_batch.airborne.filter.published import aes
from spl_batch.airborne.settings import FilterSettings
from tests.airborne.filter.test_published_filters import as_cloud

FILTERS = ("published", "aes_alone", "ours")
"""Those that take runs; AES on each flightline by itself, as in the source."""


@pytest.fixture(scope="module")
def survey(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small Easton."""
    return methods.make_survey(easton(1, (20.0, 18.0)), Path(tmp_path_factory.mktemp("easton")))


@pytest.fixture(scope="module")
def corridor(survey: Path) -> dict[str, Counts]:
    """The regions of both lines, by filter."""
    points, shots, known = methods.load_truth(survey), load(survey), methods.known_methods()
    labels = {name: (points, methods.judge(survey, known[name]) == 0) for name in FILTERS}
    labels["dcc"] = (shots.points, kept(shots))
    found = {}
    for name, (table, keep) in labels.items():
        regions = [corridors.region(spans, table) for _, spans in corridors.lines(survey)]
        first, second = (corridors.count(table, keep, region) for region in regions)
        found[name] = first + second
    return found


@pytest.mark.slow
def test_wires_are_found_in_the_order_of_the_source(corridor: dict[str, Counts]) -> None:
    # [W18] Tables 1 and 2: 89.1, 25.9, 13.4 and 59.0, 29.3, 11.1 %.
    assert corridor["published"].wire > 300
    detection = [corridor[name].detection for name in ("published", "aes_alone", "dcc")]
    assert detection[0] > detection[1] + 20 > detection[2] + 40
    assert corridor["ours"].detection >= detection[0]


@pytest.mark.slow
def test_ellipsoids_of_the_source_expect_as_much_noise_as_there_is(
    survey: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # With the density of what is listened to, 14 to 33 % more: voxels that a gate's end cuts.
    expected: list[int] = []

    def count(cloud: Cloud, settings: FilterSettings) -> Any:
        found = told(cloud, settings)
        expected.append(int(found[1].sum()))
        return found

    told = aes._expected
    monkeypatch.setattr(aes, "_expected", count)
    more = replace(methods.known_methods()["aes"], label="AES, anew")
    methods.judge(survey, replace(more, settings=(*more.settings, "products.void_max_m=19.0")))
    background = methods.load_truth(survey)["kind"] == methods.BACKGROUND
    assert sum(expected) == pytest.approx(background.sum(), rel=0.02)


@pytest.mark.slow
def test_labels_of_one_filter_are_not_read_with_those_of_another(survey: Path) -> None:
    # Both work on the same shots, and a filter that looks less far may have other blocks.
    ratio, voxel = (methods.known_methods()[name] for name in ("aes", "voxel"))
    before = set(survey.glob("out_enabled*/store/noise"))
    first, other = methods.judge(survey, ratio), methods.judge(survey, voxel)
    assert (first != other).any()
    assert len(set(survey.glob("out_enabled*/store/noise")) - before) == 2
    np.testing.assert_array_equal(methods.judge(survey, ratio), first)


@pytest.mark.slow
def test_corridors_keep_less_noise_than_by_the_published_test(corridor: dict[str, Counts]) -> None:
    ours, published = corridor["ours"], corridor["published"]
    assert ours.noise_kept < published.noise_kept
    assert ours.false_alarm < published.false_alarm


def _roof(background: float, afterpulses: float) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """A roof of 20 deg, 12 returns per m2, with noise; and which noise lies near it by the eye."""
    rng = np.random.default_rng(1)
    side, slope = 40.0, np.tan(np.radians(20.0))
    xy = rng.uniform(0, side, (rng.poisson(12 * side**2), 2))
    level = 20.0 + slope * (xy[:, 0] - side / 2)
    roof = np.column_stack([xy, level + rng.normal(0, 0.05, len(xy))])
    lag = 0.24 + rng.exponential(0.7, len(xy))
    behind = (roof - np.outer(lag, [0, 0, 1]))[rng.random(len(xy)) < afterpulses]
    noise = rng.uniform(0, side, (rng.poisson(background * side**3), 3))
    xyz = np.concatenate([roof, behind, noise])
    away = np.abs(xyz[:, 2] - 20.0 - slope * (xyz[:, 0] - side / 2))
    near = (np.arange(len(xyz)) >= len(roof)) & (away > 0.3) & (away < 5.0)
    return np.rint(xyz * 1000).astype(np.int64), near


@pytest.mark.parametrize(
    ("background", "afterpulses", "better", "by"),
    [(0.12, 0.0, "aes", 5), (0.12, 0.04, "aes", 5), (0.006, 0.12, "voxel", 30)],
)
def test_noise_decides_whether_ellipsoids_or_voxels_remove_more_of_it(
    background: float, afterpulses: float, better: str, by: float
) -> None:
    # [W17] Table 5-2, where most of it is background: 81.7 against 41.9 %.
    xyz, near = _roof(background, afterpulses)
    removed = {}
    for name in ("aes", "voxel"):
        verdict = METHODS[name].judge(as_cloud(xyz, background), FilterSettings(method=name))
        removed[name] = 100.0 * float((~verdict.signal)[near].mean())
    worse = min(removed, key=lambda name: removed[name])
    assert worse != better
    assert removed[better] > removed[worse] + by
