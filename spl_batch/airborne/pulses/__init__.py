"""Pulses: their first and last returns, how these cover what was flown, smooth surfaces."""
