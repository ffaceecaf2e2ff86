"""The null distribution of the noise test: its table, look-ups in it, and its drawing."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import map_coordinates

from spl_batch.airborne.filter.ellipsoid import null_distribution
from spl_batch.airborne.filter.ellipsoid.ellipsoid_counts import evidence
from spl_batch.airborne.filter.ellipsoid.ellipsoid_shape import shape_of
from spl_batch.airborne.filter.ellipsoid.null_distribution import (
    DENSITIES,
    draw_table,
    null_table,
    periodic_noise,
    settings_key,
)
from spl_batch.airborne.filter.ellipsoid.quantile_table import between, level_of, value_of
from spl_batch.airborne.filter.wires import wire_null
from spl_batch.airborne.settings import FilterSettings, WireSettings
from spl_batch.engine.settings.base import Section

DEFAULT = FilterSettings()


@given(st.integers(0, 2**32 - 1), st.integers(2, 6), st.integers(2, 12))
@settings(max_examples=25, deadline=None)
def test_look_ups_are_bilinear_and_each_others_inverse(seed: int, rows: int, columns: int) -> None:
    rng = np.random.default_rng(seed)
    levels = -np.cumsum(rng.uniform(0.1, 1, columns)) + 0.1
    quantile = -np.cumsum(rng.uniform(0.1, 1, (rows, columns)), axis=1)
    at = rng.uniform(0, rows - 1, 50)
    level = rng.uniform(levels[-1], levels[0], 50)
    found = value_of(at, level, quantile, levels, 0.7)
    row = np.minimum(at.astype(int), rows - 2)
    part = at - row
    for k in range(50):
        both = quantile[row[k]] * (1 - part[k]) + quantile[row[k] + 1] * part[k]
        assert found[k] == pytest.approx(np.interp(-level[k], -levels, both), abs=1e-9)
    np.testing.assert_allclose(level_of(at, found, quantile, levels, 0.7), level, atol=1e-9)


@given(st.integers(0, 2**32 - 1), st.integers(2, 50), st.integers(2, 12))
@settings(max_examples=40, deadline=None)
def test_values_between_are_those_of_scipy_to_the_bit(seed: int, rows: int, columns: int) -> None:
    rng = np.random.default_rng(seed)
    row = rng.choice([0.0, 1.0, rows - 1.0, *rng.uniform(0, rows - 1, 30)], 60)
    column = rng.choice([0.0, 1.0, columns - 1.0, *rng.uniform(0, columns - 1, 30)], 60)
    table = rng.normal(size=(rows, columns))
    expected = map_coordinates(table, [row, column], order=1, mode="nearest")
    np.testing.assert_array_equal(between(row, column, table), expected)


def test_the_shipped_table_is_that_of_the_default_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise AssertionError("drawn")

    monkeypatch.setattr(null_distribution, "draw_table", refuse)
    table = null_table(DEFAULT)
    assert table.score.shape == (len(DENSITIES), len(null_distribution.LEVELS))
    assert (np.diff(table.score, axis=1) <= 0).all()
    assert (table.own <= table.alpha).all()
    least = table.alpha + np.log(1 - DEFAULT.link_share)
    assert (table.own >= least - 0.05).all()
    with pytest.raises(AssertionError, match="drawn"):
        null_table(FilterSettings(radius_m=1.4))


def test_other_settings_are_drawn_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(null_distribution, "POINTS", 300)
    monkeypatch.setattr(null_distribution, "DENSITIES", 10.0 ** np.linspace(-2, 0, 9))
    odd = FilterSettings(neighbours=8, link_count=0)
    first = null_table(odd)
    assert null_table(odd.model_copy(update={"alpha": 0.02})) is first
    np.testing.assert_allclose(first.own, np.broadcast_to(first.alpha, first.own.shape))
    again = draw_table(odd, 300, null_distribution.DENSITIES[::2])
    np.testing.assert_array_equal(again.score, first.score)


def test_axes_are_eigenvalues_or_their_roots() -> None:
    powers = [
        shape_of(FilterSettings(axis_power=axes), 15, 1.5).power for axes in ("eigenvalue", "root")
    ]
    assert powers == [1.0, 0.5]


def test_the_shipped_table_is_what_is_drawn() -> None:
    densities = 10.0 ** np.linspace(-1.4, -0.2, 5)
    drawn = draw_table(DEFAULT, 15_000, densities)
    table = null_table(DEFAULT)
    for share, within in ((0.3, 0.15), (0.05, 0.3), (0.01, 0.6)):
        shipped = np.log(table.critical(densities, share))
        found = np.log(drawn.critical(densities, share))
        np.testing.assert_allclose(found, shipped, atol=within)
        # the count's own tail is far smaller: the ellipsoid was fitted to what it counts
        assert (shipped < np.log(share)).all()
    for of in ("alone", "link"):
        np.testing.assert_allclose(
            getattr(drawn, of)(densities, 0.05), getattr(table, of)(densities, 0.05), rtol=0.05
        )


def test_p_values_are_shares_and_vanish_without_noise() -> None:
    table = null_table(DEFAULT)
    rng = np.random.default_rng(7)
    density = 10.0 ** rng.uniform(-5, 1.5, 300)
    share = 10.0 ** rng.uniform(-7, -0.1, 300)
    score = table.critical(density, share)
    found, clear = table.p_value(density, score), score < 1
    same = np.isclose(found[clear], share[clear], rtol=1e-6)
    # a few lie where neighbouring levels share a score, and get the larger
    assert same.mean() > 0.97
    np.testing.assert_allclose(found[clear], share[clear], rtol=0.3)
    # where many have no neighbour at all, they share the largest p
    np.testing.assert_array_equal(found[~clear], 1.0)
    assert clear.mean() > 0.7
    np.testing.assert_array_equal(table.p_value(np.zeros(3), np.array([0.0, 0.5, 1.0])), 0.0)
    own = table.alone(density, 0.001)
    assert ((own <= 0.001 * (1 + 1e-9)) & (own > 0.0005)).all()
    assert (table.link(density, 0.001) <= DEFAULT.link_m * 1.001).all()


@pytest.mark.parametrize("density", [0.004, 0.2])
def test_a_box_that_repeats_itself_has_no_border(density: float) -> None:
    rng = np.random.default_rng(8)
    xyz, source, core = periodic_noise(rng, density, 4000, DEFAULT)
    number = int(core.sum())
    side = max((4000 / density) ** (1 / 3), 15.0)
    assert number == pytest.approx(density * side**3, abs=5 * np.sqrt(number))
    shift = (xyz - xyz[source]) / (1000 * side)
    np.testing.assert_allclose(shift, np.rint(shift), atol=2e-3 / side)
    assert (np.abs(shift).max(axis=1) > 0.5)[~core].all()
    found = evidence(xyz, np.full(len(xyz), density), core, DEFAULT, 1e-12)
    middle = np.all(np.abs(xyz[core] / 1000 - 15 - side / 2) < side / 4, axis=1)
    inner, outer = found.expected[core][middle], found.expected[core][~middle]
    assert inner.mean() == pytest.approx(outer.mean(), rel=0.05)
    within = (found.inside[core] >= 1)[middle].mean(), (found.inside[core] >= 1)[~middle].mean()
    assert within[0] == pytest.approx(within[1], abs=0.06)


FILTERS: dict[str, Any] = {
    "method": "aes",
    "test": "published",
    "alpha": 0.02,
    **{
        k: getattr(DEFAULT, k)
        for k in ("wires", "aes", "dcc", "pixels", "voxel", "multilevel", "cylinder")
    },
}
"""Another value of each setting that the null distribution is said not to depend on."""

TABLES = [
    pytest.param(DEFAULT, null_distribution.IRRELEVANT, id="null_table"),
    pytest.param(DEFAULT.wires, wire_null.IRRELEVANT, id="wire_null"),
]


@pytest.mark.parametrize(("section", "irrelevant"), TABLES)
def test_a_setting_is_part_of_the_key_unless_it_is_named(
    section: Section, irrelevant: frozenset[str]
) -> None:
    fields = set(type(section).model_fields)
    assert irrelevant < fields, "a setting that there is no more"
    assert set(settings_key(section, irrelevant)) == fields - irrelevant


def test_what_is_named_changes_nothing_that_is_drawn() -> None:
    density = np.array([0.05, 0.1, 0.2, 0.4, 0.8])
    given = draw_table(DEFAULT, 1500, density)
    assert set(FILTERS) == null_distribution.IRRELEVANT
    other = DEFAULT.model_copy(
        update={**FILTERS, "wires": WireSettings(enabled=False, half_length_m=7.0)}
    )
    found = draw_table(other, 1500, density)
    for name in ("score", "own", "link_m"):
        np.testing.assert_array_equal(getattr(found, name), getattr(given, name))
    lax = DEFAULT.wires.model_copy(update={"alpha": 0.05})
    share = wire_null.draw_shares(lax, 20_000, density[2:3])
    switched = lax.model_copy(update={"enabled": False, "classify": True})
    np.testing.assert_array_equal(wire_null.draw_shares(switched, 20_000, density[2:3]), share)
    assert share > 0
