"""Water polygons: the level of their water, and what lies off it."""
