r"""Photo-electrons that a receiver expects: signal, sun and dark current [W17 2.1].

========================  ==========================================
symbol                    name here
========================  ==========================================
:math:`n_s`               signal photo-electrons per beamlet and shot
:math:`\eta_h,\eta_q,\eta_r`  hologram, quantum, receiver efficiency
:math:`E_t`               energy of one *beamlet* [J]: pulse energy / beamlets
:math:`\rho_\lambda`      reflectance
:math:`\alpha`            incidence angle
:math:`A_r, R`            receiver area [m2], range [m]
:math:`\beta`             atmospheric extinction [1/m]
:math:`N_\lambda`         exoatmospheric solar irradiance [W/m2/nm]
:math:`B_\lambda`         filter bandwidth [nm]
:math:`\Omega_r`          field of view of one pixel [sr]
:math:`\theta_s`          solar zenith angle
:math:`h_a, h_{sc}`       sensor altitude, scale height [m]
:math:`T_0`               one-way atmospheric transmission
========================  ==========================================

Deviations. Eq. 2.1 gives the whole array; a beamlet gets its share of the energy.
Eq. 2.6 prints :math:`n_t^{n_t}` where the Poisson law has :math:`n^{n_t}`; the law is used.
Noise rates are per metre of slant range (two-way, :math:`c/2` metres per second).
"""

import math

from spl_batch.constants import PLANCK_J_S, SPEED_OF_LIGHT_M_S


def photon_energy_j(wavelength_nm: float) -> float:
    """Energy of one photon, h nu [J]."""
    return PLANCK_J_S * SPEED_OF_LIGHT_M_S / (wavelength_nm * 1e-9)


def signal_constant(
    efficiency: float, beamlet_energy_j: float, wavelength_nm: float, aperture_m: float
) -> float:
    r"""What of Eq. 2.1 belongs to the instrument alone [m2].

    Parameters
    ----------
    efficiency : float
        :math:`\eta_h \eta_q \eta_r`.
    beamlet_energy_j : float
        Transmitted energy of one beamlet [J].
    wavelength_nm : float
        Laser wavelength [nm].

    Returns
    -------
    float
        :math:`n_s = C \rho \cos\alpha \exp(-2 \beta R) / R^2` with this :math:`C`.

    References
    ----------
    [W17] Eq. 2.1.
    """
    area = math.pi * (aperture_m / 2) ** 2
    photons = beamlet_energy_j / photon_energy_j(wavelength_nm)
    return efficiency * photons * area / math.pi


def solar_rate_hz(
    *,
    efficiency: float,
    wavelength_nm: float,
    aperture_m: float,
    fov_rad: float,
    bandwidth_nm: float,
    irradiance_w_m2_nm: float,
    zenith_rad: float,
    off_nadir_rad: float,
    altitude_m: float,
    scale_height_m: float,
    transmission: float,
    reflectance: float,
) -> tuple[float, float]:
    r"""Photo-electrons per second and pixel from sunlight.

    Parameters
    ----------
    efficiency : float
        :math:`\eta_q \eta_r`.
    wavelength_nm, aperture_m, fov_rad, bandwidth_nm : float
        Receiver: wavelength [nm], diameter [m], full field of view [rad], filter [nm].
    irradiance_w_m2_nm, zenith_rad : float
        Sun: exoatmospheric irradiance [W/m2/nm] and zenith angle [rad].
    off_nadir_rad, altitude_m : float
        Angle of the beam off nadir [rad] and altitude of the sensor [m].
    scale_height_m, transmission, reflectance : float
        Atmosphere: scale height [m], one-way transmission :math:`T_0`; ground.

    Returns
    -------
    atmosphere_hz, surface_hz : float
        Scattered by the air below the sensor, and by the ground.

    References
    ----------
    [W17] Eq. 2.2 and 2.4.
    """
    solid_angle = math.pi * (fov_rad / 2) ** 2
    area = math.pi * (aperture_m / 2) ** 2
    common = (
        efficiency
        / photon_energy_j(wavelength_nm)
        * irradiance_w_m2_nm
        * bandwidth_nm
        * solid_angle
        * area
    )
    sec_view, sec_sun = 1 / math.cos(off_nadir_rad), 1 / math.cos(zenith_rad)
    above = math.exp(-altitude_m / scale_height_m)
    below = transmission ** ((sec_view + sec_sun) * (1 - above))
    atmosphere = (
        common * transmission ** (sec_sun * above) / (4 * math.pi * (sec_view + sec_sun))
    ) * (1 - below)
    return atmosphere, common * reflectance * below / math.pi


def transmission_above(extinction_per_m: float, altitude_m: float, scale_height_m: float) -> float:
    r"""Transmission of an exponential atmosphere above an altitude.

    Parameters
    ----------
    extinction_per_m : float
        :math:`\mu(0)` [1/m].
    altitude_m, scale_height_m : float
        Where the path begins [m], and the e-folding height [m].

    References
    ----------
    [W17] Eq. 2.3 with :math:`\mu(z) = \mu(0) \exp(-z / h_{sc})`.
    """
    return math.exp(-extinction_per_m * scale_height_m * math.exp(-altitude_m / scale_height_m))


def rate_per_m(rate_hz: float) -> float:
    """Counts per metre of slant range from counts per second."""
    return rate_hz * 2.0 / SPEED_OF_LIGHT_M_S
