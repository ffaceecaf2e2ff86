"""Level water along the track, and the noise below it."""
