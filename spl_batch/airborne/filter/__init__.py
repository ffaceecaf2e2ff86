"""Noise filter: which returns are background."""
