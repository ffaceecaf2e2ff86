"""Compiled helpers that know nothing of lidar."""
