"""Noise that is expected where kept returns lie."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spl_batch.airborne.filter.kept_noise import PARTS, within_signal
from spl_batch.airborne.report.model import Counts
from spl_batch.airborne.report.noise_model import Noise, NoiseFit
from spl_batch.airborne.report.summarise import _kept_by_chance
from spl_batch.airborne.report.survey_page import render
from spl_batch.airborne.settings import FilterSettings
from spl_batch.constants import NOISE_BACKGROUND, NOISE_SIGNAL
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds
from tests.report_data import make_report

Row = tuple[int, int, int, int, float]
"""x, y, z [mm], noise class, density [1/m3]."""

ROWS = st.lists(
    st.tuples(
        *(st.integers(-3000, 3000) for _ in "xyz"),
        st.sampled_from([NOISE_SIGNAL, NOISE_BACKGROUND]),
        st.sampled_from([0.0, 0.02, 0.5, 3.0, np.nan]),
    ),
    max_size=40,
)


def table(rows: list[Row]) -> PointTable:
    columns: dict[str, Any] = dict(
        zip(
            ("x", "y", "z", "noise_class", "noise_density"),
            np.array(rows).reshape(-1, 5).T,
            strict=True,
        )
    )
    types = {"x": np.int64, "y": np.int64, "z": np.int32, "noise_class": np.uint8}
    return PointTable({k: v.astype(types.get(k, np.float32)) for k, v in columns.items()})


def slowly(rows: list[Row], cell: Bounds) -> int:
    cubes: dict[tuple[int, int, int], int] = {}
    for x, y, z, kind, density in rows:
        i, j, k = x // 1200, y // 1200, z // 1200
        inside = cell.xmin <= i * 1200 < cell.xmax and cell.ymin <= j * 1200 < cell.ymax
        if inside and kind == NOISE_SIGNAL and np.isfinite(density):
            found = round(float(np.float32(density)) * (1.2**3 * PARTS))
            cubes[i, j, k] = max(cubes.get((i, j, k), 0), found)
    return sum(cubes.values())


@settings(deadline=None)
@given(ROWS, st.integers(-2500, 2500), st.randoms())
def test_a_cube_counts_once_wherever_cells_are_cut(rows: list[Row], cut: int, rng: Any) -> None:
    whole = Bounds(-4000, -4000, 4000, 4000)
    found = within_signal(table(rows), whole)
    assert found == slowly(rows, whole)
    west, east = Bounds(-4000, -4000, cut, 4000), Bounds(cut, -4000, 4000, 4000)
    assert within_signal(table(rows), west) + within_signal(table(rows), east) == found
    rng.shuffle(rows)
    assert within_signal(table(rows), whole) == found


def test_what_passes_by_chance_goes_with_what_is_removed() -> None:
    assert _kept_by_chance(FilterSettings(alpha=0.2), 80) == pytest.approx(20)
    assert _kept_by_chance(FilterSettings(test="published"), 80) is None
    assert _kept_by_chance(FilterSettings(method="aes"), 80) is None


@pytest.mark.parametrize(
    ("noise", "said"),
    [
        ({"test": "calibrated", "alpha": 0.001, "kept_by_chance": 40.0, "kept_within_signal": 60.0},
         ("about 40 background returns, 0.10 %", "about 60 more", "10.0 % of the signal")),
        ({"test": "published", "kept_within_signal": 60.0}, ("one point in ten", "at least 60")),
        ({"method": "voxel", "kept_within_signal": 60.0}, ("by this filter", "at least 60")),
    ],
)  # fmt: skip
def test_the_page_says_which_noise_stays(noise: dict[str, Any], said: tuple[str, ...]) -> None:
    made = Noise(**{"method": "vsaes", **noise})
    counts = Counts(points_in=2000, points_out=2000, signal=1000, background=1000)
    page = render(make_report(noise=made, counts=counts), {})
    text = page.replace("\N{NARROW NO-BREAK SPACE}", " ")
    for words in said:
        assert words in text, words
    assert "Fit below surfaces" not in text
    assert ("Noise near surfaces</dt>" in text) == (made.kept_within_signal is not None)


def test_the_page_says_how_the_filter_fits_where_nothing_stands() -> None:
    fit = NoiseFit(
        returns_below=5000, p_value=0.05, p_value_times=1.31, floating=12, floating_share=0.0004
    )
    text = render(make_report(noise=Noise(method="vsaes", test="calibrated", fit=fit)), {})
    text = text.replace("\N{NARROW NO-BREAK SPACE}", " ")
    assert "1.31 times as many have a p-value up to 0.05" in text
    assert "12 signals float, 0.04" in text
