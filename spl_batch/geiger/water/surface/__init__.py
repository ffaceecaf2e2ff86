"""Water surfaces: places and normals of pixels, refraction, rasters."""
