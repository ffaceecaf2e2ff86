"""Water surface from frames of a Geiger-mode array."""
