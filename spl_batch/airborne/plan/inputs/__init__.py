"""Inputs of an airborne survey: found, checked, and what is odd about them."""
