"""Test of adaptive ellipsoids: counts, null distribution, decision."""
