"""Terrain that may be wrong: gaps, roofs that stay, and the ground under decks."""
