"""Beams and shots: geometry, sensor path, order of returns within a shot."""
