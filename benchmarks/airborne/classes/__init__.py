"""Classes of delivered points, against producers and simulated truth."""
