"""Link budget of a scene, solved for the brightness and the noise that the scene asks for."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from spl_batch.airborne.beams.link_budget import link_constant, photon_energy_j
from spl_batch.airborne.simulate.detector import Receiver
from spl_batch.airborne.simulate.flight import Pass, pixel_offsets
from spl_batch.airborne.simulate.scene.layout import Layout
from spl_batch.airborne.simulate.scene.ray_trace import SceneArrays, lit_share
from spl_batch.airborne.simulate.scene.scene_file import Scene
from spl_batch.airborne.simulate.shots import Optics
from spl_batch.constants import SPEED_OF_LIGHT_M_S
from spl_batch.errors import WorkflowError


class Noise(NamedTuple):
    """Background of a channel of gain 1, per metre of slant range [1/m]."""

    solar_per_m: float
    dark_per_m: float
    ground_share: float  #: Of the sunlight, what the ground sends back; the air the rest.

    def at(self, sky: NDArray[np.float64]) -> NDArray[np.float64]:
        """Background where the sky is this bright: (n,) float64 [1/m]."""
        return self.solar_per_m * sky + self.dark_per_m

    def ground_at(self, sky: NDArray[np.float64]) -> NDArray[np.float64]:
        """What of it the ground sends back: (n,) float64 [1/m]."""
        return self.ground_share * self.solar_per_m * sky


def channel_gain(scene: Scene) -> NDArray[np.float64]:
    """Sensitivity of each channel relative to a normal one: (c,) float64."""
    acquisition, count = scene.acquisition, scene.instrument.beamlets
    gain = 1 + acquisition.gain_spread * np.clip(scene.chance(2).standard_normal(count), -3, 3)
    for channel, factor in acquisition.weak_channels.items():
        gain[channel - 1] *= factor
    for channel in acquisition.dead_channels:
        gain[channel - 1] = 0.0
    return gain


def make_optics(scene: Scene) -> Optics:
    """Instrument and air of a scene as numbers for the kernels."""
    sensor = scene.instrument
    px, py = pixel_offsets(
        sensor.array_columns,
        sensor.beamlet_pitch_urad * 1e-6,
        math.radians(sensor.array_rotation_deg),
    )
    return Optics(
        px,
        py,
        channel_gain(scene),
        math.radians(sensor.half_cone_deg),
        # the full divergence is to 1/e2 of the intensity: four standard deviations
        sensor.beam_divergence_urad * 1e-6 / 4,
        _or(scene.detector.range_sigma_m, sensor.range_sigma_m),
        link_constant(sensor),
        scene.sky.extinction_per_m,
    )


def make_receiver(scene: Scene) -> Receiver:
    """Dead time, afterpulses and range walk of a scene's detector, as range."""
    sensor, own = scene.instrument, scene.detector
    tail = own.tail
    return Receiver(
        sensor.dead_m,
        _or(own.afterpulse_probability, sensor.afterpulse_probability),
        _or(own.afterpulse_scale_m, sensor.afterpulse_scale_m),
        _or(own.afterpulse_lag_max_m, sensor.afterpulse_lag_max_m),
        0.0 if tail is None else tail.share,
        1.0 if tail is None else tail.scale_m,
        0.0 if tail is None or tail.power is None else tail.power,
    )


def _or(own: float | None, stated: float) -> float:
    """Value of the scene's own detector, else the instrument's stated one."""
    return stated if own is None else own


def physical_noise(scene: Scene) -> Noise:
    r"""Background at the scene's mean altitude and reflectance [W17 Eq. 2.2-2.5].

    Sunlight comes from the air below the sensor and from the ground; the transmission is that of an
    exponential atmosphere above the sensor, Eq. 2.3 with
    :math:`\mu(z) = \mu(0) \exp(-z / h_{sc})`.
    """
    sensor, sky = scene.instrument, scene.sky
    altitude = float(np.mean([f.altitude_agl_m for f in scene.flights]))
    solid_angle = math.pi * (sensor.pixel_fov_urad * 1e-6 / 2) ** 2
    area = math.pi * (sensor.aperture_m / 2) ** 2
    common = (
        sensor.quantum_efficiency
        * sensor.receiver_efficiency
        / photon_energy_j(sensor.wavelength_nm)
        * sky.irradiance_w_m2_nm
        * sensor.filter_bandwidth_nm
        * solid_angle
        * area
    )
    sec_view, sec_sun = (
        1 / math.cos(math.radians(angle)) for angle in (sensor.half_cone_deg, sky.zenith_deg)
    )
    above = math.exp(-altitude / sky.scale_height_m)
    transmission = math.exp(-sky.extinction_per_m * sky.scale_height_m * above)
    below = transmission ** ((sec_view + sec_sun) * (1 - above))
    atmosphere = common * transmission ** (sec_sun * above) / (4 * math.pi * (sec_view + sec_sun))
    atmosphere *= 1 - below
    surface = common * scene.terrain.reflectance * below / math.pi
    share = surface / max(atmosphere + surface, 1e-300)
    # ranges are half of the way that light goes
    solar, dark = (
        rate_hz * 2.0 / SPEED_OF_LIGHT_M_S
        for rate_hz in (atmosphere + surface, sensor.dark_rate_hz)
    )
    return Noise(solar, dark, share)


def solve_noise(scene: Scene, passes: list[Pass]) -> Noise:
    """Background that gives the density the scene asks for.

    A beamlet puts ``rate / cos(off-nadir)`` points into each metre of height. The sum over the
    beamlets that hit the extent, over its area, is the density at the ground.
    """
    noise = physical_noise(scene)
    if scene.sky.background_per_m3 is None:
        return noise
    gain = float(channel_gain(scene).sum())
    total = 0.0
    for run in passes:
        for piece in run.chunks:
            secant = piece.ground_range_m / run.flight.altitude_agl_m
            rate = noise.at(run.sky(run.time_of(piece.shot)))
            total += gain * float((rate * secant)[piece.inside].sum())
    density = total / (scene.extent_m[0] * scene.extent_m[1])
    if density <= 0:
        raise WorkflowError("sky: background_per_m3 needs some sunlight or dark current to scale")
    factor = scene.sky.background_per_m3 / density
    return Noise(noise.solar_per_m * factor, noise.dark_per_m * factor, noise.ground_share)


def tune_wires(scene: Scene, layout: Layout, optics: Optics, passes: list[Pass]) -> SceneArrays:
    """Arrays whose wires send back what ``returns_per_m`` asks for.

    It integrates over the beamlets that pass one metre of wire. The reflectance that solves it may
    exceed 1, for a brighter laser. ``layout`` has the places of the wires.
    """
    wire = layout.arrays.wire.copy()
    area = scene.extent_m[0] * scene.extent_m[1]
    pieces = [piece for run in passes for piece in run.chunks]
    inside = sum(int(piece.inside.sum()) for piece in pieces)
    density = inside / area / len(passes)
    ranges = np.concatenate([piece.ground_range_m for piece in pieces])
    for k, wires in enumerate(scene.wires):
        if wires.returns_per_m is None:
            continue
        range_m = float(ranges.mean()) - wires.height_m
        sigma = optics.sigma_rad * range_m
        full = optics.signal_m2 / range_m**2 * math.exp(-2 * optics.extinction_per_m * range_m)
        reach = wires.diameter_m / 2 + 5 * sigma
        offset = np.linspace(-reach, reach, 401)
        share = np.array([lit_share(abs(e), wires.diameter_m / 2, sigma) for e in offset])
        shares = full * np.outer(optics.gain, share)

        def missing(
            log_rho: float,
            shares: NDArray[np.float64] = shares,
            offset: NDArray[np.float64] = offset,
            asked: float = wires.returns_per_m,
        ) -> float:
            seen = -np.expm1(-shares * math.exp(log_rho)).sum(axis=0)
            return density * float(np.trapezoid(seen, offset)) - asked

        if missing(math.log(1e4)) < 0:
            raise WorkflowError(
                f"wires.{k}.returns_per_m: {wires.returns_per_m} is more than "
                "beamlets pass a metre of wire; fly slower or ask for less"
            )
        rho = math.exp(float(brentq(missing, math.log(1e-6), math.log(1e4))))
        wire[[line == k for line in layout.wire_line], 9] = rho
    return layout.arrays._replace(wire=wire)
