"""Path <-> value: one module a format."""
