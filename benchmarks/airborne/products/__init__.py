"""Raster products against truth."""
