"""Synthetic Geiger-mode data with a known scene [M20 ch. 3]."""

from spl_batch.geiger.coincidence.simulate.scene import simulate, simulate_file

__all__ = ["simulate", "simulate_file"]
