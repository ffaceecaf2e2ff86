"""Range walk and calibration: laws against integrals, fits against what was put in."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from spl_batch.geiger.water.pixel_geometry import HALF_C_M_NS
from spl_batch.geiger.water.ranges import (
    Calibration,
    Observation,
    faults_of,
    first_photon,
    fit,
)
from spl_batch.geiger.water.settings import CalibrationSettings

SHAPE = (8, 9)
LAW = CalibrationSettings(scale=1.02, offset_ns=80.0, pulse_ns=0.9)


def made(
    law: CalibrationSettings, *, spread_ns: float = 0.0, delay_ns: float = 0.0, dim: bool = True
) -> tuple[list[Observation], np.ndarray]:
    """Targets at four distances under a law, some of them bright; and the delays put in."""
    rng = np.random.default_rng(5)
    delay = delay_ns * rng.standard_normal(SHAPE)
    delay -= delay.mean()
    true, seen = Calibration(law, delay), []
    for distance in (2.0, 3.0, 4.0, 5.0):
        for low, high in ((0.006, 0.019), (0.1, 0.9)) if dim else ((0.1, 0.5), (0.5, 0.9)):
            intensity = rng.uniform(low, high, SHAPE)
            actual = np.full(SHAPE, distance / HALF_C_M_NS)
            hits = np.rint(20_000 * intensity).astype(np.int64)
            measured = law.scale * actual + law.offset_ns - true.walk_ns(intensity) + delay
            measured += spread_ns * rng.standard_normal(SHAPE) / np.sqrt(hits)
            seen.append(Observation(distance, actual, measured, hits, intensity, spread_ns))
    return seen, delay


@pytest.mark.parametrize("n", [1e-3, 0.3, 1.0, 8.0])
def test_the_first_photon_law_is_its_integral(n: float) -> None:
    early, _ = quad(lambda z: z * n * norm.pdf(z) * np.exp(-n * norm.cdf(z)), -9, 9)
    share = -np.expm1(-n)
    assert first_photon(np.array([share]))[0] == pytest.approx(-early / share, abs=2e-4)
    assert (np.diff(first_photon(np.linspace(0, 1, 99))) >= 0).all(), "brighter is earlier"


def test_the_source_s_own_numbers() -> None:
    source = Calibration(CalibrationSettings(range_walk="exponential"), np.zeros(3))
    intensity = np.array([0.1, 0.8, 0.5])
    found = source.ranges(np.array([105.0, 105.0, np.nan]), intensity)
    walk = 0.021900186808850 * np.exp(4.588548204216641 * intensity)
    time = (105.0 + walk - 82.3525317669176) / 1.02379235588971
    assert found[:2] == pytest.approx(time[:2] * 0.299792458 / 2)
    assert np.isnan(found[2])
    bare = Calibration(CalibrationSettings(range_walk="none"), np.zeros(1))
    assert bare.ranges(np.array([82.3525317669176]), np.array([0.9]))[0] == pytest.approx(0)


@pytest.mark.parametrize("dim", [True, False])
def test_the_joint_fit_finds_what_was_put_in(dim: bool) -> None:  # noqa: FBT001
    seen, _ = made(LAW, dim=dim)
    found = fit(seen, CalibrationSettings()).settings
    assert found.scale == pytest.approx(1.02, abs=1e-5)
    assert found.offset_ns == pytest.approx(80.0, abs=1e-3)
    assert found.pulse_ns == pytest.approx(0.9, abs=1e-3)


def test_delays_of_pixels_are_found_and_shrunk() -> None:
    seen, delay = made(LAW, spread_ns=1.0, delay_ns=0.05)
    found = fit(seen, CalibrationSettings())
    left = found.pixel_ns - delay
    assert left.std() < 0.2 * delay.std()
    assert found.residual_ns == pytest.approx(left.std(), rel=0.5)
    bare = fit(seen, CalibrationSettings(pixel_offsets=False))
    assert not bare.pixel_ns.any()
    assert bare.residual_ns == pytest.approx(0.05, rel=0.3)
    still, _ = made(LAW, spread_ns=1.0)
    assert fit(still, CalibrationSettings()).pixel_ns.std() < 0.01, "noise is not a delay"


def test_the_source_s_fit_finds_what_was_put_in() -> None:
    source = CalibrationSettings(range_walk="exponential")
    put = {"scale": 1.02, "offset_ns": 80.0, "walk_ns": 0.03, "walk_exponent": 4.0}
    seen, _ = made(source.model_copy(update=put))
    found = fit(seen, source).settings
    assert found.scale == pytest.approx(1.02, abs=1e-3)
    # Dim pixels show no range walk although theirs is A: it goes into the offset.
    assert found.offset_ns == pytest.approx(80.0 - 0.03 * np.exp(4.0 * 0.0125), abs=0.02)
    walk = Calibration(found, np.zeros(SHAPE)).walk_ns(np.array([0.8]))
    assert walk[0] == pytest.approx(0.03 * (np.exp(3.2) - np.exp(0.05)), abs=0.02)
    assert faults_of(made(LAW, dim=False)[0], source)
    empty = Observation(2, np.ones(SHAPE), np.ones(SHAPE), np.zeros(SHAPE, int), np.ones(SHAPE), 1)
    assert "frames[1]" in faults_of([seen[0], empty], LAW)[0]
