"""Trajectories of any format, joined and read by slices."""
