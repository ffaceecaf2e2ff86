"""Pure noise of two flightlines: what is kept along their gates and across their overlap."""

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from spl_batch.airborne.filter.ellipsoid.ellipsoid_test import judge
from spl_batch.airborne.filter.filter_interface import Cloud
from spl_batch.airborne.noise.local_noise import SQUARES, around, listened
from spl_batch.airborne.noise.voxel_chords import deposit_beamlets
from spl_batch.airborne.noise.voxel_noise import BEAMLET, sphere_radius_m
from spl_batch.airborne.settings import FilterSettings
from spl_batch.lattice.tables import FIXED_POINT

Floats = NDArray[np.float64]

SIDE_M = 90.0
CORE_M = 14.0
"""What lies so far within the sides is looked at: the test reaches farther than it looks."""
PER_M3 = 0.08
PER_M2 = 12.0
"""Noise, and beamlets that are seen, of one flightline."""
GATES_M = ((11.4, 78.6), (13.2, 77.1))
"""Ends that cut off less than a sixth of the spheres of a layer."""
EDGE_M = 46.5
"""Where the second flightline begins, along x."""
LEAN = np.array([0.0, np.sin(0.26), -np.cos(0.26)])
DRAWS = 4
PAD = 3


@cache
def lines() -> tuple[NDArray[np.float32], ...]:
    """What the two flightlines listen to, from their beamlets."""
    rng = np.random.default_rng(5)
    found = []
    for (low, high), west in zip(GATES_M, (0.0, EDGE_M), strict=True):
        n = rng.poisson(PER_M2 * (SIDE_M - west) * (SIDE_M + 40.0))
        place = np.column_stack(
            [rng.uniform(west, SIDE_M, n), rng.uniform(-20, SIDE_M + 20, n), np.full(n, 45.0)]
        )
        ends = (45.0 - np.array([high, low])) / -LEAN[2]
        shape = (9 + 2 * PAD, 13 + 2 * PAD, 9 + 2 * PAD)
        corner = np.array([-PAD, -PAD - 2, -PAD])
        voxel = np.floor(place / 10.0).astype(np.int64)
        amount = np.zeros(shape, np.int64)
        squares = np.zeros((*shape, SQUARES**2), np.uint16)
        none = np.zeros((0, 0, 0), np.int64)
        weight = PER_M3 / PER_M2 * -LEAN[2] * FIXED_POINT
        deposit_beamlets(
            voxel - corner, place - (voxel + 0.5) * 10.0, np.tile(LEAN, (n, 1)),
            np.full(n, ends[0]), np.full(n, ends[1]), np.full(n, weight), 10.0,
            sphere_radius_m(10.0), np.arange(n), amount, none, none, np.full(n, BEAMLET), squares,
        )  # fmt: skip
        heard = listened(amount, squares, 10.0)
        assert heard is not None
        found.append(heard)
    return tuple(found)


def density(xyz: Floats) -> Floats:
    """Noise expected at places [1/m3]."""
    return around(lines(), np.rint(xyz.T * 1e3).astype(np.int64), 10_000, (-PAD, -PAD - 2, -PAD))


def noise(seed: int) -> Floats:
    """Returns of both flightlines, uniform where each of them listens: (n, 3) [m]."""
    rng = np.random.default_rng([6, seed])
    found = []
    for (low, high), west in zip(GATES_M, (0.0, EDGE_M), strict=True):
        n = rng.poisson(PER_M3 * (SIDE_M - west) * SIDE_M * (high - low))
        found.append(rng.uniform((west, 0.0, low), (SIDE_M, SIDE_M, high), (n, 3)))
    return np.concatenate(found)


def core(xyz: Floats) -> NDArray[np.bool_]:
    """Those whose neighbourhood lies within the sides."""
    inner: NDArray[np.bool_] = np.abs(xyz[:, :2] - SIDE_M / 2).max(axis=1) < SIDE_M / 2 - CORE_M
    return inner


FAR_M = 1000.0
PLACES = {
    "under the upper ends": ((-FAR_M, FAR_M), (70, 75)),
    "over the lower ends": ((-FAR_M, FAR_M), (15, 20)),
    "between": ((-FAR_M, FAR_M), (25, 65)),
    "one flightline": ((-FAR_M, EDGE_M - 5), (16, 75)),
    "beside the overlap": ((EDGE_M - 5, EDGE_M + 5), (16, 75)),
    "two flightlines": ((EDGE_M + 5, FAR_M), (16, 75)),
}
"""Where x and z lie."""


def within(xyz: Floats, name: str) -> NDArray[np.bool_]:
    """Those in one of the places."""
    x, z = PLACES[name]
    inside: NDArray[np.bool_] = (xyz[:, 0] > x[0]) & (xyz[:, 0] < x[1])
    return inside & (xyz[:, 2] > z[0]) & (xyz[:, 2] < z[1])


@pytest.mark.parametrize("name", [name for name in PLACES if name != "beside the overlap"])
def test_the_density_is_the_true_one_up_to_the_ends(name: str) -> None:
    xyz = noise(0)
    mine = core(xyz) & (np.abs(xyz[:, 0] - EDGE_M) > 5) & within(xyz, name)
    true = PER_M3 * np.where(xyz[mine, 0] > EDGE_M, 2, 1)
    assert np.mean(density(xyz[mine]) / true) == pytest.approx(1, abs=0.03)


@cache
def kept(alpha: float) -> tuple[Floats, NDArray[np.bool_]]:
    """Noise in the core, and whether the test with its links keeps it."""
    places, signal = [], []
    for seed in range(DRAWS):
        xyz = np.rint(1000 * noise(seed)).astype(np.int32)
        xyz = xyz[np.lexsort(xyz.T[::-1])]
        asked = core(xyz / 1000.0)
        per_m3 = density(xyz / 1000.0)
        cloud = Cloud(xyz, (0, 0, 0), per_m3, asked, np.zeros(len(xyz), np.bool_))
        places.append(xyz[asked] / 1000.0)
        signal.append(judge(cloud, FilterSettings(alpha=alpha)).signal)
    return np.concatenate(places), np.concatenate(signal)


@pytest.mark.parametrize("name", PLACES)
def test_alpha_of_noise_is_kept_along_the_gate_and_across_the_overlap(name: str) -> None:
    for alpha, margin in ((0.05, 0.2), (0.01, 0.4)):
        xyz, signal = kept(alpha)
        share = signal[within(xyz, name)].mean()
        assert share / alpha == pytest.approx(1, abs=margin), alpha
