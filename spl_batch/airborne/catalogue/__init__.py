"""What of a delivery other tools open at once: STAC, a virtual point cloud, an index.

The names are those of files and folders below the output.
"""

from typing import Final

INDEX: Final = "index.gpkg"
"""Files, flightlines and checkpoints as layers, with counts."""

STAC: Final = "stac"
"""Folder of the catalogue."""

VIRTUAL: Final = "survey.vpc"
"""Virtual point cloud."""

CONTOURS: Final = "contours.gpkg"
"""Contours of the terrain."""

CLIENT_TILES: Final = "client_tiles"
"""Folder of what a client's polygons cut out."""

REPROJECTED: Final = "reprojected"
"""Folder of clouds and rasters in another CRS or unit."""
