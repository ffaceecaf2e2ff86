"""Few photons of signal under a bright sky: neighbourhoods by how photons crowd."""

import numpy as np
import pytest

from benchmarks.altimetry.photon_beams import RATE, SIGNAL, Beam
from spl_batch.altimetry.noise import noise_rate as rates
from spl_batch.altimetry.noise.crowding import _pairs
from spl_batch.altimetry.noise.neighbourhoods import aspects
from tests.altimetry.tracks import assert_cut_matters_nowhere, quanta

DAY = 0.03


def sparse(slope: float, seed: int = 1, length_m: float = 4000.0) -> tuple[np.ndarray, np.ndarray]:
    """Ground that goes up and down, 0.25 photons a metre: (n, 2) [m], and which are signal."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(0.0, length_m, rng.poisson(0.25 * length_m))
    z = slope * np.abs(x % 800.0 - 400.0) + rng.normal(0.0, 0.15, len(x))
    sky = rng.uniform((0.0, -60.0), (length_m, 120.0), (rng.poisson(DAY * 180.0 * length_m), 2))
    track = np.concatenate([np.stack([x, z], axis=1), sky])
    order = np.argsort(track[:, 0], kind="stable")
    return track[order], (np.arange(len(track)) < len(x))[order]


def test_pairs_are_counted_in_boxes_of_an_absolute_lattice() -> None:
    rng = np.random.default_rng(5)
    along = np.sort(rng.integers(-90_000, 90_000, 300))
    along[200:] += 500_000
    height = rng.integers(-9_000, 30_000, 300).astype(np.int32)
    cell = np.unique(along // 20_000, return_inverse=True)[1]
    found = _pairs(along, cell, height, cell.max() + 1, 600.0, 6.0)
    expected = np.zeros(cell.max() + 1)
    for i in range(300):
        for shift in (0, 5_000):
            same = along // 60_000 == along[i] // 60_000
            same &= (height + shift) // 10_000 == (height[i] + shift) // 10_000
            expected[cell[i]] += (np.count_nonzero(same) - 1) / 2.0
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize(("slope", "low", "high"), [(0.0, 20.0, 20.0), (0.1, 8.0, 20.0),
    (0.6, 3.0, 5.0)])  # fmt: skip
def test_sparse_ground_under_a_bright_sky_has_neighbourhoods_of_its_slope(
    slope: float, low: float, high: float
) -> None:
    cells = rates.observe(*quanta(sparse(slope)[0]), RATE)
    assert low <= np.median(aspects(cells, SIGNAL)) <= high


def test_sparse_level_ground_is_found_by_day() -> None:
    """Four fifths of the F1 is found; with the shortest neighbourhoods a third was."""
    track, signal = sparse(0.004)
    beam = Beam(quanta(track), None)
    kept = beam.keep(beam.score())
    both = np.count_nonzero(kept & signal)
    assert 2 * both / (kept.sum() + signal.sum()) > 0.8
    assert beam.doubtful == 0


def test_it_does_not_depend_on_the_cut() -> None:
    along, height = quanta(sparse(0.05, length_m=3000.0)[0])
    assert_cut_matters_nowhere(along, height, 71)
