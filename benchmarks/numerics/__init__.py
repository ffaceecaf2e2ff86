"""Measurements of compiled helpers."""
