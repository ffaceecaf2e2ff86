"""Sensor presets as data files."""
