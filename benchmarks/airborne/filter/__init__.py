"""Noise filters, against point truth and pure noise."""
