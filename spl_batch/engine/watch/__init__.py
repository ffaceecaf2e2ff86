"""Events of a run, its log, and its state as others see it."""
