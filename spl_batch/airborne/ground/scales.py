"""Scales that ground and water are found by: what several rules share, and what follows from it."""

from typing import Final

CELL_M: Final = 1.0
"""Edge of the cells that nodes are taken from and that the opening runs on [m]."""

SIGMA_M: Final = 0.05
"""Standard deviation of a range, if flightlines have no larger one [m]."""

LAYER_M: Final = 3 * SIGMA_M
"""How far a return lies from its surface at the most [m]."""
