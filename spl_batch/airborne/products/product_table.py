"""The rasters of an airborne survey: one table that plan, stages, delivery and report read."""

from typing import Final, NamedTuple


class Product(NamedTuple):
    """A raster."""

    name: str  #: Name of its array in the store, and of its file.
    meaning: str  #: What it holds, as its band is called.
    #: Unit of its values, as GDAL's unit type; 1 where they have none: where the CRS has a vertical
    #: part an empty one is read as metres.
    unit: str
    delivered: bool = True  #: Whether it goes into the output; else it serves the report alone.
    is_map: bool = False  #: Whether it is one of the maps of ``products.maps``.
    #: Of counts: colours of 0, 1 and so on, the last one for all above.
    colours: tuple[str, ...] = ()


SWATHS: Final = ("#d7301f", "#fdd49e", "#c7e9c0", "#74c476", "#238b45", "#00441b")
"""No flightline is red, one pale, more are greener."""

PRODUCTS: Final = (
    Product("dtm", "height of the terrain", "m"),
    Product("dtm_quality", "standard deviation of the height of the terrain", "m"),
    Product("dsm", "height of the surface", "m"),
    Product("chm", "height of the surface above the terrain", "m"),
    Product("density", "signal returns per m2", "1/m2"),
    Product("intensity", "mean LAS intensity of first returns", "1"),
    Product("first_returns", "first returns of pulses per m2", "1/m2", is_map=True),
    Product("last_returns", "last returns of pulses per m2", "1/m2", is_map=True),
    Product("voids", "edge of the largest empty square of four spacings", "m", is_map=True),
    Product("swaths", "flightlines with a first return", "1", is_map=True, colours=SWATHS),
    Product("noise", "expected noise", "1/m3", delivered=False),
)
"""Every raster, in the order in which they are written."""

REFLECTANCE: Final = Product("intensity", "reflectance from detections, 1 is all light", "1")
"""What ``intensity`` holds where detections tell how much light came back."""

NAMES: Final = tuple(product.name for product in PRODUCTS)
"""Names of all rasters."""


HILLSHADE: Final = Product("hillshade", "shaded relief of the terrain", "1", is_map=True)
"""Made of the finished terrain model, not of ground cells."""

SWATH_DIFFERENCES: Final = Product(
    "swath_differences", "median height between flightlines that overlap", "m", is_map=True
)
"""Made of planar patches that two flightlines share, on a coarse grid of its own."""

ABOVE_GEOID: Final = (
    Product("dtm_geoid", "height of the terrain above the geoid", "m"),
    Product("dsm_geoid", "height of the surface above the geoid", "m"),
)
"""Made of the finished models, where a geoid is named."""


def products(*, reflectance: bool, maps: bool = False) -> tuple[Product, ...]:
    """Every raster of a survey.

    Parameters
    ----------
    reflectance : bool
        Whether the intensity raster is made of detections, and not of the input's values.
    maps : bool
        Whether there are maps of pulses, voids and swaths.
    """
    of_detections = {REFLECTANCE.name: REFLECTANCE} if reflectance else {}
    wanted = (product for product in PRODUCTS if maps or not product.is_map)
    return tuple(of_detections.get(product.name, product) for product in wanted)
