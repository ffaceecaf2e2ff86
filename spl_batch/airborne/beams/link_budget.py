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

from spl_batch.airborne.sensors.sensor import Sensor
from spl_batch.constants import PLANCK_J_S, SPEED_OF_LIGHT_M_S


def photon_energy_j(wavelength_nm: float) -> float:
    """Energy of one photon, h nu [J]."""
    return PLANCK_J_S * SPEED_OF_LIGHT_M_S / (wavelength_nm * 1e-9)


def link_constant(sensor: Sensor) -> float:
    r"""What of Eq. 2.1 belongs to the instrument alone [m2].

    :math:`n_s = C \rho \cos\alpha \exp(-2 \beta R) / R^2` with this :math:`C`: photo-electrons of
    a beamlet per reflectance, times square of range [W17 Eq. 2.1].
    """
    area = math.pi * (sensor.aperture_m / 2) ** 2
    efficiency = sensor.hologram_efficiency * sensor.quantum_efficiency * sensor.receiver_efficiency
    energy_j = sensor.pulse_energy_uj * 1e-6 / sensor.beamlets
    return efficiency * (energy_j / photon_energy_j(sensor.wavelength_nm)) * area / math.pi
