"""Surfaces from coincident detections: voxel raster, quadratic fit, test."""
