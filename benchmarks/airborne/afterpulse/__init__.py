"""Afterpulses found and missed, against point truth."""
