"""How flightlines that overlap differ in height and place, from planar patches of both.

:mod:`patches` finds the patches of a ground cell, :mod:`pair_table` makes of all patches one
row for each pair of flightlines; :mod:`alignment` the heights that
bring them together; :mod:`comparison` holds the tasks of a run that call them.
"""
