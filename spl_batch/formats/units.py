"""Units of lengths: work is done in metres, files are in the unit that their CRS names.

Coordinates of a CRS times :class:`Units` are metres on the same axes: a pure factor, no projection.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS
from pyproj.database import get_units_map

from spl_batch.constants import FOOT_M, US_FOOT_M
from spl_batch.errors import grouped

METRE: Final = "metre"
FOOT: Final = "foot"
US_FOOT: Final = "US survey foot"

NAMES: Final[Mapping[str, str]] = MappingProxyType({"m": METRE, "ft": FOOT, "us-ft": US_FOOT})
"""PROJ's names of the units that a workflow can name."""

COMMON: Final = {METRE: 1.0, FOOT: FOOT_M, US_FOOT: US_FOOT_M}
"""Units of deliveries by PROJ's names [m]; files name them in many ways, with as many digits."""

_IN_WORDS: Final = {METRE: "metres", "foot": "feet", US_FOOT: "US survey feet"}

_SAME_UNIT: Final = 5e-7
"""Relative difference within which a unit is one of these: both feet differ by 2e-6."""


@dataclass(frozen=True, slots=True)
class Units:
    """Units of a CRS, by PROJ's names, and the metres in one of each."""

    horizontal: str = METRE
    horizontal_m: float = 1.0
    vertical: str = METRE
    vertical_m: float = 1.0

    @classmethod
    def of(cls, crs: CRS | None) -> Self:
        """Units of a CRS; metres without one, and in place of degrees.

        Heights that no vertical axis has a unit for are in that of eastings.
        """
        return cls() if crs is None else cls(*_of_wkt(crs.to_wkt()))

    def shown_in(self, key: str, *, horizontal: bool) -> Self:
        """The same with heights in a unit of :data:`NAMES`, and with ``horizontal`` all axes."""
        name = NAMES[key]
        flat = (name, COMMON[name]) if horizontal else (self.horizontal, self.horizontal_m)
        return type(self)(*flat, name, COMMON[name])

    @property
    def are_metres(self) -> bool:
        """Whether nothing has to be converted."""
        return self.horizontal_m == self.vertical_m == 1.0

    @property
    def xyz_m(self) -> tuple[float, float, float]:
        """Metres in a unit of easting, northing and height."""
        return self.horizontal_m, self.horizontal_m, self.vertical_m

    @property
    def of_heights(self) -> tuple[str, float]:
        """Unit of heights as pages write it, and the metres in it."""
        return _written(self.vertical), self.vertical_m

    @property
    def of_coordinates(self) -> tuple[str, float]:
        """Unit of eastings and northings as pages write it, and the metres in it."""
        return _written(self.horizontal), self.horizontal_m

    def of_values(self, unit: str) -> tuple[str, float]:
        """Unit in which a raster's values [``unit``] are delivered, and ``unit`` in one of it."""
        lengths = unit == "m" and self.vertical_m != 1.0
        return (self.vertical, self.vertical_m) if lengths else (unit, 1.0)

    def metres(self, coordinates: NDArray[np.float64]) -> NDArray[np.float64]:
        """Coordinates of the CRS, (n, 2 or 3), in metres."""
        return coordinates if self.are_metres else coordinates * self.xyz_m[: coordinates.shape[1]]


def _written(name: str) -> str:
    return "ft" if name.endswith("foot") else "m" if name == METRE else name


def in_words(unit: str) -> str:
    """A unit by PROJ's name, as a sentence has it: ``US survey feet``."""
    return _IN_WORDS.get(unit, unit)


def both(metres: float, unit: tuple[str, float], digits: int | None = 2) -> str:
    """A length in a unit of delivery, metres beside: ``12.30 ft (3.75 m)``; of metres these alone.

    ``unit``: its name, and the metres in it, as of :attr:`Units.of_heights`; ``digits``: decimals,
    None for none from ten on, else hundredths where there are any.
    """
    name, unit_m = unit
    text = f"{_decimals(metres, digits)} m"
    return text if unit_m == 1.0 else f"{_decimals(metres / unit_m, digits)} {name} ({text})"


def _decimals(value: float, digits: int | None) -> str:
    if digits is None and abs(value) < 10:
        return f"{round(value, 2):g}"
    return grouped(value, digits or 0)


METRES: Final = Units()
"""Of a CRS in metres, and of everything between reading and writing."""


@lru_cache(maxsize=64)
def _of_wkt(wkt: str) -> tuple[str, float, str, float]:
    """Fields of :class:`Units` by a CRS, of which a survey has few."""
    crs = CRS.from_wkt(wkt)
    flat: list[tuple[str, float]] = []
    upright: list[tuple[str, float]] = []
    for axis in crs.axis_info:
        kind = upright if axis.direction in {"up", "down"} else flat
        kind.append(_named(axis.unit_name, axis.unit_conversion_factor))
    horizontal = (METRE, 1.0) if crs.is_geographic or not flat else flat[0]
    return (*horizontal, *(upright or [horizontal])[0])


def _named(name: str, metres: float) -> tuple[str, float]:
    """A unit by its common name, if it has one, and the metres in it."""
    for common, exact in COMMON.items():
        if abs(metres / exact - 1.0) < _SAME_UNIT:
            return common, exact
    return name, metres


@lru_cache(maxsize=64)
def metres_in(unit: str) -> float | None:
    """Metres in a unit by PROJ's name; None of one that PROJ does not know."""
    if unit in COMMON:
        return COMMON[unit]
    known = get_units_map(auth_name="EPSG", category="linear").get(unit)
    return None if known is None else float(known.conv_factor)
