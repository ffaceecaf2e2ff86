"""Planes that are fitted side by side are those that each set gives alone."""

from itertools import pairwise

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from spl_batch.airborne.afterpulse.hard_surfaces import densest
from spl_batch.numerics.planes.robust_plane import BISQUARE, FLATTEST
from spl_batch.numerics.planes.robust_planes_simd import fit_planes

Floats = NDArray[np.float64]
LEAST = 0.03


def slow_weighted(u: Floats, v: Floats, w: Floats, weight: Floats) -> list[float] | None:
    """Least squares, number by number in the order of the returns."""
    total = mu = mv = mw = 0.0
    for g, x, y, z in zip(*(a.tolist() for a in (weight, u, v, w)), strict=True):
        total, mu, mv, mw = total + g, mu + g * x, mv + g * y, mw + g * z
    if total <= 0.0:
        return None
    mu, mv, mw = mu / total, mv / total, mw / total
    uu = uv = vv = uw = vw = 0.0
    for g, x, y, z in zip(*(a.tolist() for a in (weight, u, v, w)), strict=True):
        du, dv, dw = x - mu, y - mv, z - mw
        uu, uv, vv = uu + g * du * du, uv + g * du * dv, vv + g * dv * dv
        uw, vw = uw + g * du * dw, vw + g * dv * dw
    determinant = uu * vv - uv * uv
    if determinant <= FLATTEST * ((uu + vv) * (uu + vv)):
        return None
    b, c = (uw * vv - vw * uv) / determinant, (vw * uu - uw * uv) / determinant
    return [mw - b * mu - c * mv, b, c]


def slow_plane(u: Floats, v: Floats, w: Floats) -> tuple[list[float], Floats] | None:
    """Robust plane of one set and its weights."""
    weight = np.ones(len(u))
    plane = slow_weighted(u, v, w, weight)
    for _ in range(30):
        if plane is None:
            return None
        a, b, c = before = plane
        distance = np.abs(w - (a + b * u + c * v))
        ratio = distance / (BISQUARE * max(float(np.median(distance)) / 0.6745, LEAST))
        weight = np.where(ratio < 1.0, (1.0 - ratio * ratio) * (1.0 - ratio * ratio), 0.0)
        plane = slow_weighted(u, v, w, weight)
        if plane and max(abs(x - y) for x, y in zip(plane, before, strict=True)) < 1e-6:
            break
    return None if plane is None else (plane, weight)


def fitted(
    sizes: list[int], member: NDArray[np.int64], u: Floats, v: Floats, w: Floats
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    first = np.concatenate([[0], np.cumsum(sizes, dtype=np.int64)])
    plane, weight = np.zeros((len(sizes), 3)), np.zeros(first[-1])
    there = np.zeros(len(sizes), np.bool_)
    fit_planes(len(sizes), first, member.astype(np.uint64), u, v, w, LEAST, plane, weight, there)
    return plane, weight, there


@settings(deadline=None, max_examples=30)
@given(
    st.lists(st.integers(4, 30) | st.integers(4, 100), max_size=20),
    st.sampled_from([0.0, 0.3, 1.0]),
    st.integers(0, 1000),
)
def test_each_plane_is_that_of_its_set_alone(sizes: list[int], stray: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    u, v = np.round(rng.uniform(-2, 2, (2, 400)), 1)
    u[:40], v[:10] = 1.0, 0.5
    w = 3 + 0.4 * u - 0.2 * v + rng.normal(0, 0.04, 400)
    w += (rng.random(400) < stray) * rng.exponential(1.0, 400)
    member = rng.integers(0, rng.choice([40, 400]), sum(sizes))
    plane, weight, there = fitted(sizes, member, u, v, w)
    bounds = np.concatenate([[0], np.cumsum(sizes, dtype=np.int64)])
    for one, (low, high) in enumerate(pairwise(bounds)):
        rows = member[low:high]
        alone = slow_plane(u[rows], v[rows], w[rows])
        assert there[one] == (alone is not None)
        if alone is not None:
            assert plane[one].tolist() == alone[0]
            np.testing.assert_array_equal(weight[low:high], alone[1])


@given(
    st.lists(st.floats(0.0, 5.0) | st.sampled_from([1.0, 1.5, 2.0]), min_size=1, max_size=40),
    st.sampled_from([0.0, 0.5, 1.0]),
)
@settings(deadline=None)
def test_the_fullest_window_is_the_nearest_of_equals(ranges: list[float], width: float) -> None:
    around = np.array([0.5, *ranges, *np.ones(8)])
    counts = {at: sum(0.0 <= r - at <= width for r in ranges) for at in ranges}
    best = max(counts.values())
    expected = min(at for at, count in counts.items() if count == best), best
    assert densest(around, 1, len(ranges) + 1, width) == expected
