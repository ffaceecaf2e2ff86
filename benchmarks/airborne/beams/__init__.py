"""Measurements of beam geometry and light."""
