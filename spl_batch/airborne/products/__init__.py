"""Raster products and classes of points."""
