"""From frames to hits, ranges, surfaces and rasters."""
