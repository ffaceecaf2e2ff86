"""Plan of an airborne survey: stretches, tiles, cells, ground cells, tasks, cost."""
