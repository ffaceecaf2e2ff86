"""Ground points and water levels."""
