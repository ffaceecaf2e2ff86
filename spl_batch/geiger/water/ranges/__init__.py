"""Ranges of pixels: hits, calibration, range walk."""
