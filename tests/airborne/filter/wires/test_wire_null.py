"""What the scan keeps of pure noise: its table, look-ups in it, and its drawing."""

import numpy as np
import pytest

from spl_batch.airborne.filter.wires import wire_null
from spl_batch.airborne.filter.wires.wire_null import DENSITIES, WireNull, fitted, spent
from spl_batch.airborne.settings import FilterSettings, WireSettings

DEFAULT = FilterSettings()
LINEAR = WireNull(np.log([0.01, 0.1, 1.0]), np.array([1e-4, 3e-4, 2e-4]), 0.5)


@pytest.fixture
def linear(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wire_null, "wire_null", lambda _: LINEAR)


def test_the_shipped_table_is_that_of_the_default_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise AssertionError("drawn")

    monkeypatch.setattr(wire_null, "draw_shares", refuse)
    table = wire_null.wire_null(DEFAULT.wires)
    np.testing.assert_allclose(np.exp(table.density), DENSITIES, rtol=1e-4)
    assert (table.share >= 0).all()
    assert 0 < table.share.max() < DEFAULT.wires.alpha
    assert 0.5 < table.power < 1.5
    sure = DEFAULT.wires.model_copy(update={"classify": True})
    assert wire_null.wire_null(sure) is table, "it changes no label"
    with pytest.raises(AssertionError, match="drawn"):
        wire_null.wire_null(WireSettings(radius_m=0.3))


@pytest.mark.usefixtures("linear")
def test_shares_are_interpolated_by_the_logarithm_and_hold_beyond() -> None:
    density = np.array([0.0, 0.001, 0.01, 10.0**-1.5, 0.1, 1.0, 50.0])
    expected = np.array([1, 1, 1, 2, 3, 2, 2]) * 1e-4
    np.testing.assert_allclose(spent(density, DEFAULT), expected)
    off = DEFAULT.model_copy(update={"wires": WireSettings(enabled=False)})
    np.testing.assert_array_equal(spent(density, off), 0.0)


@pytest.mark.usefixtures("linear")
@pytest.mark.parametrize("alpha", [1e-2, 1e-4])
def test_the_scan_gets_stricter_where_it_would_take_more_than_half(alpha: float) -> None:
    settings = FilterSettings(alpha=alpha)
    part = fitted(settings).alpha / settings.wires.alpha
    most = spent(np.array([0.1]), settings)[0]
    if alpha >= 6e-4:
        assert part == pytest.approx(1)
        assert most == pytest.approx(3e-4)
    else:
        assert part == pytest.approx((0.5 * alpha / 3e-4) ** 2)
        assert most == pytest.approx(0.5 * alpha)


def test_what_is_drawn_is_the_share_that_the_scan_keeps() -> None:
    loose = WireSettings(alpha=0.2, half_length_m=6, seed_share=1.0)
    densities = np.array([0.05, 0.2])
    share = wire_null.draw_shares(loose, 8000, densities)
    np.testing.assert_array_equal(wire_null.draw_shares(loose, 8000, densities), share)
    assert ((share > 0.002) & (share < 0.4)).all()
    strict = loose.model_copy(update={"alpha": 0.02})
    assert (wire_null.draw_shares(strict, 8000, densities) < share).all()


def test_other_settings_are_drawn_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wire_null, "POINTS", 500)
    odd = WireSettings(half_length_m=7)
    first = wire_null.wire_null(odd)
    assert len(first.share) == len(wire_null.COARSE)
    assert wire_null.wire_null(odd) is first
