"""Bare arrays in and out, without input or output."""
