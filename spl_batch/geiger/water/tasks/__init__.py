"""Tasks of the water surface."""
