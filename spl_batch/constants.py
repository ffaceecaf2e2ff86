"""Physics and fixed conventions that every storey shares.

Nothing here is a setting: a value that a user may want to change lives in
:mod:`spl_batch.airborne.settings.workflow`, an instrument's fact in
:mod:`spl_batch.airborne.sensors.sensor`.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

SPEED_OF_LIGHT_M_S: Final = 299_792_458.0
"""Vacuum speed of light [m/s]."""

PLANCK_J_S: Final = 6.626_070_15e-34
"""Planck's constant [J s]."""

QUANTUM_M: Final = 0.001
"""Edge of the survey-wide coordinate lattice [m].

Working coordinates are integers on this absolute lattice, so that a difference
between two points does not depend on the tile, block or file that holds them.
"""

QUANTA_PER_M: Final = 1000
"""Lattice steps per metre; the reciprocal of :data:`QUANTUM_M` [1/m]."""

NODATA: Final = -9999.0
"""Value of raster cells that hold nothing."""

GPS_WEEK_S: Final = 604_800
"""Seconds in a GPS week [s]."""

ADJUSTED_STANDARD_OFFSET_S: Final = 1_000_000_000
"""LAS adjusted standard GPS time is GPS time less this [s]."""

CLASS_NEVER_CLASSIFIED: Final = 0
CLASS_UNCLASSIFIED: Final = 1
CLASS_GROUND: Final = 2
CLASS_LOW_VEGETATION: Final = 3
CLASS_MEDIUM_VEGETATION: Final = 4
CLASS_HIGH_VEGETATION: Final = 5
CLASS_BUILDING: Final = 6
CLASS_LOW_NOISE: Final = 7
CLASS_WATER: Final = 9
CLASS_OVERLAP: Final = 12
CLASS_WIRE: Final = 14
CLASS_HIGH_NOISE: Final = 18
"""ASPRS LAS 1.4 classes that the delivered clouds use; class 12, which overlap points had before
there was a flag for them, is not to be used."""

CLASS_NAMES: Final[Mapping[int, str]] = MappingProxyType(
    {
        CLASS_NEVER_CLASSIFIED: "never classified",
        CLASS_UNCLASSIFIED: "unclassified",
        CLASS_GROUND: "ground",
        CLASS_LOW_VEGETATION: "low vegetation",
        CLASS_MEDIUM_VEGETATION: "medium vegetation",
        CLASS_HIGH_VEGETATION: "high vegetation",
        CLASS_BUILDING: "building",
        CLASS_LOW_NOISE: "low noise",
        CLASS_WATER: "water",
        CLASS_WIRE: "wire",
        CLASS_HIGH_NOISE: "high noise",
    }
)
"""Classes of LAS that this project gives or reads [LAS 1.4 R15, table 17]."""

FLAG_WITHHELD: Final = 4
FLAG_OVERLAP: Final = 8
"""Classification flags of a point record of formats 6 to 10 [LAS 1.4 R15, 2.6]."""

NOISE_SIGNAL: Final = 0
NOISE_BACKGROUND: Final = 1
NOISE_AFTERPULSE: Final = 2
NOISE_NOT_ASSESSED: Final = 255
"""Values of the delivered extra byte ``noise_class``."""

FOOT_M: Final = 0.3048
US_FOOT_M: Final = 1200.0 / 3937.0
"""An international foot, and a US survey foot, 2 parts in a million longer [m]."""
