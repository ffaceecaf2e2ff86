"""Photon files of altimeters: path to value and back."""
