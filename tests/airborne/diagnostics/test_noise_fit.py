"""Noise against its model: by layer, in haze, and by p-values where it lies alone."""

from types import SimpleNamespace

import numpy as np
import pytest

from spl_batch.airborne.diagnostics.noise_fit import P_VALUES, haze, noise_findings, uniformity

CORE = [0, 0, 100_000, 100_000]


def receipts(layers=(), airs=(), p_values=()):
    blocks = {
        f"{k}_0": SimpleNamespace(facts={"layers": rows, "air": [], "core": CORE})
        for k, rows in enumerate(layers)
    }
    for k, air in enumerate(airs):
        blocks[f"a{k}"] = SimpleNamespace(facts={"layers": [], "air": air, "core": CORE})
    cells = {
        f"{k}_1": SimpleNamespace(facts={"p_values": counts, "core": CORE})
        for k, counts in enumerate(p_values)
    }
    return {"denoise": blocks, "ground": cells}


def codes(**facts):
    return [(one.code, one.subject) for one in noise_findings(receipts(**facts))]


EVEN = [[layer, 1000, 1010.0] for layer in range(-20, 20)]


def test_noise_that_fits_its_model_is_no_finding():
    assert codes(layers=[EVEN]) == []
    assert codes() == []
    by_chance = [[layer, 12, 9.0] for layer in range(40)]
    assert codes(layers=[by_chance[:1]]) == []


@pytest.mark.parametrize(("times", "wanted"), [(1.4, 1.4), (0.6, 0.6)])
def test_noise_that_changes_along_the_gate_is_found_with_its_heights(times, wanted):
    rows = EVEN[:20] + [[layer, 1000 * times, 1000.0] for layer in range(20)]
    (one,) = noise_findings(receipts(layers=[rows[:28], rows[28:]]))
    assert (one.code, one.subject) == ("N02", ""), "one for the whole survey"
    assert one.values["ratio"] == pytest.approx(wanted)
    assert (one.values["low_m"], one.values["high_m"]) == (0.0, 100.0)


def test_a_block_of_its_own_is_named_with_its_place():
    odd = [[layer, 4000 if 10 <= layer < 18 else 1000, 1000.0] for layer in range(24)]
    sound = [EVEN] * 30
    (one,) = noise_findings(receipts(layers=[*sound, odd]))
    assert (one.code, one.subject, one.place) == ("N02", "30_0", (0.0, 0.0, 100.0, 100.0))
    assert one.values["ratio"] == pytest.approx(4.0, rel=0.3)
    few = [[layer, seen / 100, due / 100] for layer, seen, due in odd]
    assert codes(layers=[*sound, few]) == [], "too few to judge a block by"


def test_returns_where_no_noise_is_expected_are_found():
    (one,) = noise_findings(receipts(layers=[[[0, 1000, 0.0]]]))
    assert (one.code, one.values["ratio"]) == ("N02", 999.0)
    assert codes(layers=[[[0, 0, 0.0]]]) == []


def place(column, row=0, returns=1000, expected=50.0, low=12, high=19):
    return [5 * column, 5 * row, 5 * column + 5, 5 * row + 5, low, high, 25, 200, returns, expected]


def test_haze_has_area_heights_and_its_largest_place():
    found = haze(receipts(airs=[[place(k) for k in range(4)], [place(40)]]))
    assert found is not None
    assert found.values["area_m2"] == 5 * 625.0
    assert found.place == (0.0, 0.0, 100.0, 25.0)
    assert (found.values["low_m"], found.values["high_m"]) == (60.0, 100.0)
    assert found.values["ratio"] == pytest.approx(20.0)
    assert haze(receipts(airs=[[place(k, returns=50) for k in range(4)]])) is None
    small = place(0)
    small[6] = 10
    assert haze(receipts(airs=[[small]])) is None
    assert ("N03", "") in codes(airs=[[place(k) for k in range(4)]])


def by_p_value(times, total=20_000):
    below = np.array([0.0, *P_VALUES]) * total * times
    counts = np.diff(below).round().astype(int).tolist()
    return [*counts, total - sum(counts)]


def test_p_values_that_are_not_uniform_are_found_by_cell():
    assert codes(p_values=[by_p_value(1.0), by_p_value(1.3)]) == []
    assert codes(p_values=[by_p_value(1.0), by_p_value(2.0)]) == [("N05", "1_1")]
    assert codes(p_values=[by_p_value(0.3)]) == [("N05", "0_1")]
    assert codes(p_values=[by_p_value(2.0, 90)]) == [], "too few"
    many = [by_p_value(2.0, 600)] * 5
    assert codes(p_values=many) == [("N05", "")], "together they are enough"
    assert uniformity(np.zeros(6, np.int64)) is None
