"""Geiger-mode receivers: arrays of detectors that fire once for each laser pulse."""
