"""Filters of other authors, for comparison."""
