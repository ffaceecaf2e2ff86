"""Terrain that may be wrong: gaps in the ground, and roofs that stay."""
