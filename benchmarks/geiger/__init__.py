"""Measurements of Geiger-mode receivers."""
