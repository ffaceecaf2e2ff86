"""Measurements of the airborne survey as a whole."""
