r"""Photo-electrons of a surface that a receiver expects [W17 2.1].

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
========================  ==========================================

Deviation: Eq. 2.1 gives the whole array; a beamlet gets its share of the energy.
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
