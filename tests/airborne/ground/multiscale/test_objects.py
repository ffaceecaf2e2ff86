"""Objects among nodes of the ground: sets whose outline steps down, and a linear program's."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import linprog
from scipy.sparse import coo_array

from spl_batch.airborne.ground.multiscale.objects import _UNITS, SHARE, neighbours, objects
from spl_batch.airborne.ground.scales import PLANE_M

Float = NDArray[np.float64]
Mask = NDArray[np.bool_]

SIZE = 60


def scene(kind: str) -> tuple[Float, Mask]:
    """Nodes of squares of 1 m with something in their middle, and which are its [m]."""
    rng = np.random.default_rng(4)
    x, y = (v.ravel() + rng.uniform(0.1, 0.9, SIZE**2) for v in np.indices((SIZE, SIZE)))
    east, north = x - 30, y - 30
    inside = (np.abs(east) <= 6) & (np.abs(north) <= 6)
    z = np.zeros(x.size)
    if kind == "terrace":  # of which the opening left what is far from its edge
        inside = (x > 30) & (x < 40)
        z[x > 30] = 4.0
    elif kind == "mound":
        z = np.maximum(0.0, 6.0 - 0.8 * np.hypot(east, north))
    elif kind == "deck":  # 8 m wide over a valley of 20 m
        inside = (np.abs(east) < 10) & (np.abs(north) < 4)
        z[(np.abs(east) < 10) & ~inside] = -6.0
    elif kind == "hillside":
        z = 1.2 * x + np.where(inside, 3.0, 0.0)
    else:
        z[inside] = {"house": 4.0, "kerb": 0.6, "tower": 12.0}[kind]
    return np.column_stack([x, y, z + rng.normal(0, 0.03, x.size)]), inside


@pytest.mark.parametrize(
    ("kind", "goes"),
    [
        ("house", True),
        ("kerb", False),
        ("tower", True),
        ("terrace", False),
        ("mound", False),
        ("deck", True),
        ("hillside", True),
    ],
)
def test_roofs_and_decks_are_taken_off_and_terrain_stays(kind: str, *, goes: bool) -> None:
    nodes, inside = scene(kind)
    found = objects(nodes, ~inside)
    assert not found[~inside].any()
    assert found[inside].mean() > 0.9 if goes else not found.any()
    assert not objects(nodes[~found], np.ones(np.count_nonzero(~found), np.bool_)).any()


def test_what_the_opening_left_speaks_against_it() -> None:
    nodes, inside = scene("house")
    few = inside & (np.random.default_rng(1).random(len(nodes)) < 0.1)
    assert objects(nodes, ~inside | few)[inside].all()
    assert not objects(nodes, np.ones(len(nodes), np.bool_)).any()


def test_neighbours_step_by_more_than_the_slope_gives() -> None:
    nodes, inside = scene("house")
    upper, lower, level = neighbours(nodes)
    assert (nodes[upper, 2] >= nodes[lower, 2]).all()
    assert np.array_equal(np.unique([upper, lower]), np.arange(len(nodes)))
    assert level.max() <= 1.0
    across = inside[upper] != inside[lower]
    assert across.sum() > 80
    assert np.array_equal(level <= 0.0, across)
    steep = nodes * [1.0, 1.0, 0.0] + [[0.0, 0.0, 1.7]] * nodes[:, :1]
    assert neighbours(steep)[2].min() > 0.0


@pytest.mark.parametrize("seed", range(4))
def test_the_set_that_goes_is_that_of_a_linear_program(seed: int) -> None:
    """Blocks on a slope: the least cost of any set, of which the smallest is taken off."""
    rng = np.random.default_rng(seed)
    x, y = (v.ravel() + rng.uniform(0.1, 0.9, 400) for v in np.indices((20, 20)))
    block = rng.integers(0, 2, (7, 7))[(x // 3).astype(int), (y // 3).astype(int)]
    nodes = np.column_stack([x, y, 0.2 * x + 2.5 * block + rng.normal(0, 0.2, 400)])
    opened = rng.random(400) < 0.5
    gone = np.zeros(400, np.bool_)
    while (left := np.flatnonzero(~gone)).size > 20:
        found = _least_cost(nodes[left], opened[left])
        gone[left[found]] = True
        if not found.any():
            break
    assert np.array_equal(objects(nodes, opened), gone)
    assert 20 < gone.sum() < 380


def _least_cost(nodes: Float, opened: Mask) -> Mask:
    """Whether each node is in the smallest set of the least cost."""
    upper, lower, level = neighbours(nodes)
    cost = SHARE * opened
    for i, j, even in zip(upper, lower, level, strict=True):
        if even <= 0:
            near = np.exp(-np.sum((nodes[i, :2] - nodes[j, :2]) ** 2) / PLANE_M**2)
            cost[i] -= SHARE * near
            cost[j] += SHARE * near
    linked = level > 0
    one, other, link = upper[linked], lower[linked], level[linked]
    # The flow is of whole units, and what stays and what goes cost the same twice.
    down = cost - SHARE * opened
    units = np.rint(_UNITS * (np.maximum(down, 0) + SHARE * opened)) - np.rint(
        _UNITS * np.maximum(-down, 0)
    )
    n, m = len(nodes), len(link)
    row, pair = np.arange(m), n + np.arange(m)
    ends = [np.concatenate([v, w, pair]) for v, w in ((one, other), (other, one))]
    signs = np.concatenate([np.ones(m), -np.ones(m), -np.ones(m)])
    most = coo_array(
        (
            np.tile(signs, 2),
            (np.concatenate([np.tile(row, 3), m + np.tile(row, 3)]), np.concatenate(ends)),
        ),
        shape=(2 * m, n + m),
    )
    size = np.concatenate([units + 1e-3, np.rint(_UNITS * link)])
    found = linprog(size, A_ub=most.tocsr(), b_ub=np.zeros(2 * m), bounds=(0, 1)).x[:n]
    assert np.abs(found - np.rint(found)).max() < 1e-6
    chosen: Mask = found > 0.5
    return chosen
