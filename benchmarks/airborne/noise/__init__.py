"""Expected against true noise."""
