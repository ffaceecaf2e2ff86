"""Measurements of file formats."""
