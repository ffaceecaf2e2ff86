"""Scales that ground and water are found by: what several rules share, and what follows from it.

Heights follow from how far ranges scatter, lengths from the cells that nodes are taken from.
"""

from typing import Final

CELL_M: Final = 1.0
"""Edge of the cells that nodes are taken from and that the opening runs on [m]."""

BESIDE_M: Final = 2 * CELL_M
"""What lies beside a node: so far a wall's edge reaches, and so far others continue a node [m]."""

WIDE_M: Final = 4 * CELL_M
"""Edge of cells that hold ground nearly everywhere, under crowns too: of low outliers, of the
lattice of a trend, and how far from ground that shows a contour [m]."""

LEVELS: Final = 3
"""So often the cell that nodes are the lowest of may double."""

BLOCK_M: Final = 2 * 2**LEVELS * CELL_M
"""Edge of the blocks of an absolute grid that share a cell size, a spacing and a spread [m]: those
without points are voids."""

WINDOW_M: Final = 40.0
"""Radius of the largest window of an opening, and how far off a wall counts [m]."""

PLANE_M: Final = 6.0
"""Nodes about a plane count by exp(-(distance / this)^2): those that are 8 m off support no edge
[m]."""

NEAREST: Final = 20
"""Planes go through so many of the nearest nodes [count]."""

DAMPING_M2: Final = 0.1
"""Added to the scatter of positions when a plane is fitted: a slope that they do not show is none
[m2]."""

SIGMA_M: Final = 0.05
"""Standard deviation of a range, if flightlines have no larger one [m]."""

SPREADS: Final = 3.0
"""What lies farther off than so many spreads is something else's: of a layer of returns by what
ranges scatter, of nodes above planes by what nodes scatter."""

LAYER_M: Final = SPREADS * SIGMA_M
"""How far a return lies from its surface at the most [m]."""

ROUGH_M: Final = 4 * SIGMA_M
"""Heights of one surface, a rough one too, scatter by no more [m]: with 0.15 m the error of ISPRS
sample 71 grows by 5 cm."""

DEPTH_M: Final = 5 * SIGMA_M
"""What lies so far below a surface is no part of it [m]."""

WALL_M: Final = 2.0
"""Height of a wall: a low storey [m]."""

EDGE_M: Final = 1.5
"""Fall at the edge of a terrace, a deck or a roof on a hillside, and what is clear above a sheet
[m]: with that of a wall the error of ISPRS sample 71 grows by 4 cm."""

STEEP: Final = 0.5
TILT: Final = 0.3
"""Slopes from which on ground is steep, and below which it is level [rise/run]."""

SIDES: Final = 8
"""Ground goes on to a node from so many sides, and from so many of the nodes around [count]."""
