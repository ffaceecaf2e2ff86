"""Plan of an airborne survey: stretches, tiles, blocks, ground cells, tasks, cost."""
