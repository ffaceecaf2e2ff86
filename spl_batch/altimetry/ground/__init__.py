"""Ground and canopy top along the track."""
