"""The rasters of an airborne survey: one table that plan, stages, delivery and report read."""

from typing import Final, NamedTuple

MOST_PIXELS: Final = 2**34
"""Cells of a raster of a whole survey, at most [count]: 130 km x 130 km of square metres."""


class Product(NamedTuple):
    """A raster."""

    name: str  #: Name of its array in the store, and of its file.
    meaning: str  #: What it holds, as its band is called.
    #: Unit of its values, as GDAL's unit type; 1 where they have none: where the CRS has a vertical
    #: part an empty one is read as metres.
    unit: str
    delivered: bool = True  #: Whether it goes into the output; else it serves the report alone.


PRODUCTS: Final = (
    Product("dtm", "height of the terrain", "m"),
    Product("dtm_quality", "standard deviation of the height of the terrain", "m"),
    Product("dsm", "height of the surface", "m"),
    Product("chm", "height of the surface above the terrain", "m"),
    Product("density", "signal returns per m2", "1/m2"),
    Product("intensity", "mean LAS intensity of first returns, of all without one", "1"),
    Product("noise", "expected noise", "1/m3", delivered=False),
)
"""Every raster, in the order in which they are written."""

REFLECTANCE: Final = Product("intensity", "reflectance from detections, 1 is all light", "1")
"""What ``intensity`` holds where detections show how much light came back."""

HEIGHTS: Final = ("dtm", "dsm")
"""Rasters of heights above the datum, which change with it; other lengths are differences."""

NAMES: Final = tuple(product.name for product in PRODUCTS)
"""Names of all rasters."""

ABOVE_GEOID: Final = (
    Product("dtm_geoid", "height of the terrain above the geoid", "m"),
    Product("dsm_geoid", "height of the surface above the geoid", "m"),
)
"""Made of the finished models, where a geoid is named."""


def products(*, reflectance: bool) -> tuple[Product, ...]:
    """Every raster of a survey; ``reflectance``: whether the intensity is made of detections."""
    of_detections = {REFLECTANCE.name: REFLECTANCE} if reflectance else {}
    return tuple(of_detections.get(product.name, product) for product in PRODUCTS)
