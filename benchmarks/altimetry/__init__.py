"""Measurements of photon profiles."""
