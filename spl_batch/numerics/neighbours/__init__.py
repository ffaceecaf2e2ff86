"""Nearest neighbours on the integer lattice: kd-tree and searches."""
