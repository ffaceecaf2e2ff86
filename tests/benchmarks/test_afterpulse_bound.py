"""The best possible filter of afterpulses: its sum over sources, against sums done by hand."""

import itertools
import math

import numpy as np
import pytest

from benchmarks.airborne.afterpulse import afterpulse_bound as bound
from spl_batch.airborne.simulate.detector import Receiver

RECEIVER = Receiver(0.24, 0.15, 0.7, 3.0)

# The plain functions: what the compiled ones do is the same, and nothing needs compiling.
due_of, cluster = bound._due.py_func, bound._cluster.py_func


def _law(lag: float) -> float:
    whole = 1.0 - math.exp(-2.76 / 0.7)
    return 0.15 * math.exp(-(lag - 0.24) / 0.7) / (0.7 * whole) if 0.24 <= lag <= 3.0 else 0.0


def test_the_law_is_that_of_the_simulation() -> None:
    at = np.array([10.0, 10.1, 10.5, 12.9, 13.5])
    due, spent = due_of(at, RECEIVER)
    expected = [[_law(b - a) if b > a else 0.0 for a in at] for b in at]
    np.testing.assert_allclose(due, expected, atol=1e-12)
    steps = np.linspace(0.24, 3.0, 200_001)
    dead = np.any([(10.0 + steps >= a) & (10.0 + steps < a + 0.24) for a in at[1:]], axis=0)
    alive = np.mean([0.0 if d else _law(s) for s, d in zip(steps[::50], dead[::50], strict=True)])
    assert spent[0] == pytest.approx(alive * 2.76, rel=5e-3)


def test_sums_over_sources_are_those_of_all_assignments() -> None:
    at = np.array([10.0, 10.4, 10.9, 11.6, 12.2])
    n = len(at)
    due, spent = due_of(at, RECEIVER)
    real = np.array([0.3, 0.05, 0.2, 0.4, 0.01])
    total, echo = 0.0, np.zeros(n)
    for sources in itertools.product(*[[-1, *range(i)] for i in range(n)]):
        parents = [s for s in sources if s >= 0]
        if len(set(parents)) < len(parents):
            continue
        weight = math.prod(real[i] if s < 0 else due[i, s] for i, s in enumerate(sources))
        weight *= math.prod(1.0 - spent[j] for j in range(n) if j not in parents)
        total += weight
        for i, s in enumerate(sources):
            echo[i] += weight * (s >= 0)
    found = np.zeros(n)
    assert cluster(0, n, due, spent, real, found) == pytest.approx(math.log(total))
    np.testing.assert_allclose(found, echo / total, atol=1e-12)
    assert 0.0 < found[1:].min() < found.max() < 1.0


def test_places_of_the_footprint_have_the_spread_of_the_beam() -> None:
    places = bound.footprint(4001)
    np.testing.assert_allclose(places.mean(axis=0), 0.0, atol=0.01)
    np.testing.assert_allclose(np.cov(places.T), np.eye(2), atol=0.02)
