"""Files of an airborne survey in the working store: labels, raster cells, voxels."""
