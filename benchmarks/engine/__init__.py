"""Measurements of the engine: memory, time, scheduling, equal bytes."""
