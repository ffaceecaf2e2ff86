"""Water surfaces that breaklines give to a terrain model."""
