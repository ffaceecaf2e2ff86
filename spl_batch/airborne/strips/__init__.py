"""How flightlines that overlap differ in height and place, from planar patches of both.

:mod:`strip_patches` finds the patches of a ground cell, :mod:`pair_table` makes of all patches one
row for each pair of flightlines; :mod:`strip_comparison` holds the tasks of a run that call them.
"""
