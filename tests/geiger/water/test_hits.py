"""Gate, intensity, mean bin and dead pixels, against sums that are written out."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spl_batch.geiger.water.ranges import (
    Gate,
    add_up,
    dead_pixels,
    find_gate,
    histogram,
    used_pixels,
)
from spl_batch.geiger.water.settings import CameraSettings, GateSettings, PixelSettings


@settings(deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 30), st.integers(1, 50), st.integers(1, 30))
def test_sums_are_those_of_the_hits_in_the_gate(seed: int, n: int, low: int, width: int) -> None:
    frames = np.random.default_rng(seed).integers(0, 61, (n, 4, 5)).astype(np.uint16)
    made = add_up(frames, Gate(low, low + width))
    for i, j in np.ndindex(4, 5):
        values = frames[:, i, j].astype(int)
        inside = values[(values >= low) & (values < low + width) & (values > 0)]
        assert made.hits[i, j] == len(inside)
        assert made.total[i, j] == sum(v - low for v in inside)
        assert made.square[i, j] == sum((v - low) ** 2 for v in inside)
        assert made.outside[i, j] == (values > 0).sum() - len(inside)
        assert made.intensity[i, j] == pytest.approx(len(inside) / len(frames))
        mean = made.mean_bin()[i, j]
        assert np.isnan(mean) if not len(inside) else mean == pytest.approx(inside.mean())
    used = np.random.default_rng(0).random((4, 5)) < 0.7
    values = frames[:, used]
    np.testing.assert_array_equal(
        histogram(frames, used, 60), np.bincount(values[values > 0], minlength=61)
    )


def test_large_bins_do_not_overflow() -> None:
    made = add_up(np.full((3, 1, 1), 65_535, np.uint16), Gate(1, 65_536))
    assert made.square[0, 0] == 3 * 65_534**2


def test_the_spread_of_single_hits_is_pooled_over_pixels() -> None:
    rng = np.random.default_rng(3)
    centre = 400 + 10 * np.arange(20).reshape(4, 5)
    frames = np.rint(centre + 4.0 * rng.standard_normal((3000, 4, 5))).astype(np.uint16)
    gate = Gate(300, 700)
    assert add_up(frames, gate).spread_bins() == pytest.approx(4.0, rel=0.02)
    halves = add_up(frames[:7], gate) + add_up(frames[7:], gate)
    assert halves.spread_bins() == add_up(frames, gate).spread_bins()
    assert np.isnan(add_up(frames[:1], gate).spread_bins())


def test_the_gate_lies_around_the_peak_and_inside_the_frame() -> None:
    counts = np.zeros(1001, dtype=np.int64)
    counts[405:422] = [1, 2, 4, 7, 11, 16, 20, 23, 24, 23, 20, 16, 11, 7, 4, 2, 1]
    counts[900] = 50
    assert find_gate(counts, GateSettings()) == Gate(390, 437), "one loud bin is no echo"
    assert find_gate(counts, GateSettings(centre_bin=5)) == Gate(1, 48)
    assert find_gate(counts, GateSettings(centre_bin=999)) == Gate(976, 1001)
    assert find_gate(np.zeros(100, dtype=np.int64), GateSettings()) is None
    flat = np.where((np.arange(1001) >= 400) & (np.arange(1001) < 420), 5, 0)
    assert find_gate(flat, GateSettings()) == Gate(386, 433), "the middle of a flat top"


def test_dead_and_hot_pixels_are_found() -> None:
    rng = np.random.default_rng(4)
    camera = CameraSettings(rows=12, cols=12, last_rows_unused=2)
    frames = np.where(rng.random((400, 12, 12)) < 0.3, 100, 0).astype(np.uint16)
    frames[:, 3, 4] = 0
    frames[1:, 6, 6] = 0
    frames[::2, 8, 1] = 900
    hits = add_up(frames, Gate(90, 110))
    dead = dead_pixels(hits, used_pixels(camera), PixelSettings(dead=((0, 0),)))
    found = set(map(tuple, np.argwhere(dead[:10]).tolist()))
    assert found == {(3, 4), (6, 6), (8, 1), (0, 0)}
    assert dead[10:].all()
