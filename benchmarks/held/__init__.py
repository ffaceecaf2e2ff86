"""Figures that must hold from commit to commit; run ``python -m benchmarks.held``."""
