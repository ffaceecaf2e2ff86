"""Nearest neighbours on the integer lattice: kd-tree, searches, columns."""
