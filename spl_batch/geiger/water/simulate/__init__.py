"""Frames of simulated surfaces with their truth."""

from spl_batch.geiger.water.simulate.files import simulate_file

__all__ = ["simulate_file"]
