"""Planes through points: eigenvectors, robust fits, eight at a time."""
