"""Delaunay triangulations and linear interpolation on them."""
