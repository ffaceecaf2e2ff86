"""Ground under closed woods: the faint layer below the crowns, and what tells that it is missed."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spl_batch.altimetry.ground.cell_ground import clear_layers
from spl_batch.altimetry.ground.profile import profile
from spl_batch.altimetry.ground.under_crowns import doubt_told
from spl_batch.altimetry.report.beam_warnings import _doubt
from spl_batch.altimetry.settings import ProfileSettings
from tests.altimetry.tracks import quanta

WHOLE = (-(10**9), 10**9)
LENGTH_M = 2000.0


def wood(ground_per_m: float, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Photons of uneven crowns, two a metre, and of gentle ground below them [quanta]."""
    rng = np.random.default_rng(seed)
    n, m = int(2.0 * LENGTH_M), int(ground_per_m * LENGTH_M)
    x = rng.uniform(0.0, LENGTH_M, n + m)
    high = (20.0 + 10.0 * np.sin(x / 17.0) * np.sin(x / 61.0)) * rng.beta(3.0, 1.6, n + m)
    z = ground_m(x) + np.where(np.arange(n + m) < n, high, rng.normal(0.0, 0.2, n + m))
    order = np.argsort(x)
    return quanta(np.stack([x, z], axis=1)[order])


def ground_m(x: np.ndarray) -> np.ndarray:
    return 5.0 * np.sin(x / 300.0)


def columns_of(ground_per_m: float) -> dict[str, np.ndarray]:
    along, height = wood(ground_per_m)
    sure = np.ones(len(along), np.bool_)
    return profile(along, height, sure, WHOLE, ProfileSettings()).columns


def test_ground_below_fuller_crowns_is_found() -> None:
    columns = columns_of(0.3)
    off = columns["ground"] - ground_m(columns["along_track"])
    assert np.nanmedian(np.abs(off)) < 0.1
    assert (np.abs(off) < 1.0).mean() > 0.85


def test_ground_that_is_missed_is_in_doubt_by_metres() -> None:
    columns = columns_of(0.06)
    off = columns["ground"] - ground_m(columns["along_track"])
    wrong = off > 2.0
    assert wrong.mean() > 0.5
    assert (columns["doubt"][wrong] > 2.0).mean() > 0.9
    assert (np.abs(off) < 2.0 * columns["ground_error"]).mean() > 0.85
    told = doubt_told(columns, 20.0)
    assert told["cells"] == np.count_nonzero(columns["doubt"])
    assert 2.0 < told["depth_m"] < 10.0
    facts = {"doubt": told, "ground_cells": len(off)}
    (sentence,) = _doubt(facts)
    assert "ground may lie in the crowns" in sentence
    assert not list(_doubt({**facts, "ground_cells": 10_000}))


def test_bare_and_wooded_ground_that_is_seen_is_in_no_doubt() -> None:
    assert not columns_of(2.0)["doubt"].any()
    told = doubt_told(columns_of(2.0), 20.0)
    assert not list(_doubt({"doubt": told, "ground_cells": 100}))


def clearest(x: np.ndarray, z: np.ndarray, layer_m: float, steps: int) -> float:
    """How clear the clearest layer of a cell is, slope by slope."""
    best = 0.0
    for slope in np.linspace(-1.0, 1.0, 2 * steps + 1):
        bins = np.floor((z - slope * x) / (layer_m / 3.0))
        for b in np.unique(bins):
            for middle in (b - 1, b, b + 1):
                inside = np.abs(bins - middle) <= 1
                # An empty bin on either side is all that there is beyond the photons.
                if not bins.min() <= middle <= bins.max() or np.count_nonzero(inside) < 3:
                    continue
                below = np.count_nonzero((bins < middle - 2) & (bins >= middle - 20))
                held, expected = np.count_nonzero(inside), 3.0 * below / 18.0 + 1.0
                if held > expected:
                    best = max(best, held * np.log(held / expected) - held + expected)
    return best


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.integers(0, 15))
def test_a_clear_layer_is_found_where_one_is_as_clear(seed: int, ground: int) -> None:
    rng = np.random.default_rng(seed)
    x = np.sort(rng.uniform(-30.0, 30.0, 40))
    z = np.where(np.arange(40) < ground, rng.normal(0.0, 0.1, 40), rng.uniform(3.0, 25.0, 40))
    z = rng.permuted(z)
    along = np.rint(x * 1000.0).astype(np.int64)
    ends = np.array([0]), np.array([40]), np.array([0])
    out = np.empty((1, 2))
    clear_layers(along, z, *ends, 1.5, 1.0, 20, 3, out)
    best = clearest(along / 1000.0, z, 1.5, 20)
    assert np.isnan(out[0, 0]) == (best <= 3.0)
    if ground >= 12:
        assert out[0] == pytest.approx([0.0, 0.0], abs=0.6)
