"""Several methods on the same photon profiles."""
