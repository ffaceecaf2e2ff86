"""Tables of the sources on simulated twins of their surveys."""
