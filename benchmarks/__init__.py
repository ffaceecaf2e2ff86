"""Measurements: each module prints its figures, with a peer or an oracle in the same run."""
