"""What the standards ask of a survey: limits by quality level, and of every level.

Sources: USGS Lidar Base Specification 2025 rev. A, Table 1 (aggregate nominal pulse spacing and
density), Table 2 (relative vertical accuracy), Table 4 (absolute vertical accuracy), Collection
Requirements; ASPRS Positional Accuracy Standards for Digital Geospatial Data, Edition 2, Version
1.0 (2023), by section.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final, NamedTuple


class Level(NamedTuple):
    """Limits of a quality level [m, 1/m2]; USGS Lidar Base Specification, Tables 1, 2 and 4."""

    rmse_v_m: float
    pulses_per_m2: float
    spacing: str  #: Key of its nominal pulse spacing.
    spacing_m: float
    overlap_rmsd_m: float  #: Swath overlap difference, RMSDz.


LEVELS: Final[Mapping[str, Level]] = MappingProxyType(
    {
        "QL0": Level(0.05, 8.0, "QL1", 0.35, 0.04),
        "QL1": Level(0.10, 8.0, "QL1", 0.35, 0.08),
        "QL2": Level(0.10, 2.0, "QL2", 0.71, 0.08),
        "QL3": Level(0.20, 0.5, "QL3", 1.41, 0.16),
    }
)
"""Limits by quality level."""


class Asked(NamedTuple):
    """Numbers that hold for every quality level."""

    checkpoints: int = 30  #: Of a kind, for a statement [ASPRS 7.13].
    #: Checkpoints' own accuracy, of the largest RMSE_V: they shall be twice as accurate
    #: [ASPRS 7.12].
    known_share: float = 0.5
    #: Mean error, of the largest RMSE_V, from which on it is to be looked into [ASPRS 7.2].
    mean_share: float = 0.25
    #: Squares of twice the nominal spacing that hold a first return, 0..1 [USGS, Spatial
    #: Distribution and Regularity].
    filled_share: float = 0.9
    void_spacings: int = 4  #: Edge of a data void [nominal spacings; USGS, Data Voids].
    #: Slope up to which a patch counts for differences of heights: 10 degrees [rise/run; USGS,
    #: Relative Vertical Accuracy].
    flat: float = 0.176


ASKED: Final = Asked()
"""Of every survey."""
