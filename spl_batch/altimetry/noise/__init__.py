"""Noise rate along the track."""
