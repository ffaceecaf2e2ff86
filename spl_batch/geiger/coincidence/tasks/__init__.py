"""Tasks of coincidence processing."""
