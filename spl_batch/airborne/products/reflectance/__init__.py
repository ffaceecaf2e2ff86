"""Reflectance from how many of the fired beamlets were seen."""
