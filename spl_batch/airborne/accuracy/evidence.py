"""What a run knows of what a contract asks for."""

from collections.abc import Mapping
from dataclasses import dataclass

from spl_batch.airborne.accuracy.checkpoint_errors import CheckpointStatistics
from spl_batch.airborne.pulses.swaths import SwathTotals
from spl_batch.engine.report.number_format import height
from spl_batch.formats.units import METRES, Units, both


@dataclass(frozen=True, slots=True)
class PulseTotals:
    """First returns of a whole survey, water excepted."""

    pulses: int
    area_m2: float
    #: squares, filled: squares of twice the nominal spacing, and those that hold a first return
    #: [count].
    squares: int
    filled: int
    void_m2: float
    #: Area that was flown and lies beyond every signal: off the edge, or in holes wider than
    #: products.void_max_m can fill. It is in no other number [m2].
    bare_m2: float

    @property
    def outside_voids_per_m2(self) -> float:
        """First returns by the area outside voids: a lake does not make it less [1/m2]."""
        seen_m2 = self.area_m2 - self.void_m2
        return self.pulses / seen_m2 if seen_m2 > 0.0 else 0.0


@dataclass(frozen=True, slots=True)
class SwathDifferences:
    """Heights of flightlines against each other where they overlap."""

    rmsd_m: float  #: RMSDz over all pairs, at smooth places of up to 10 degrees [m].
    #: Pairs of flightlines; places that both of a pair have [count].
    pairs: int
    places: int


@dataclass(frozen=True, slots=True)
class Evidence:
    """What a run knows of what is required."""

    level: str
    #: Limits asked for, the level's unless the contract has others [m, 1/m2].
    rmse_v_m: float
    pulses_per_m2: float
    #: Accuracy at checkpoints; None where none were given.
    nva: CheckpointStatistics | None
    vva: CheckpointStatistics | None
    pulses: PulseTotals | None  #: First returns, by the level's spacing; None without any.
    single: bool  #: Whether each swath is judged by itself; else all of them together.
    by_swath: Mapping[str, SwathTotals]  #: First returns of each flightline, by its name.
    water_known: bool  #: Whether polygons show where water is.
    swaths: SwathDifferences | None  #: None where no flightlines were compared.
    flightlines: int
    classes: Mapping[int, int]  #: Points by class [count].
    withheld_unclassified: int  #: Those of class 0 that the vendor withheld [count].
    filtered: bool  #: Whether a noise filter ran.
    has_crs: bool  #: Whether the survey's CRS is known.
    vertical_datum: str | None  #: Name of the vertical datum of the CRS.
    time_standard: str | None  #: GPS time of the points, in words.
    units: Units = METRES  #: What is delivered.

    def height(self, metres: float | None) -> str:
        """A height as requirements show it."""
        return height(metres, self.units.of_heights)

    def edge(self, metres: float) -> str:
        """An edge of a square as requirements show it."""
        return both(metres, self.units.of_coordinates)
