"""Afterpulses: how often they come, candidates, the decision."""
