"""Integer coordinates, tiles, ownership, order of rows, and the tables of points."""
