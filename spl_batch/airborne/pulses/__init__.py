"""Pulses: their first returns, and how densely and evenly these cover what was flown."""
