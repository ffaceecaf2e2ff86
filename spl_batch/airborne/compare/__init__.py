"""Comparison of several filters on one survey."""
