"""Tasks of an airborne survey: read, call a step, crop to what is owned, write."""
