"""Bare loops over rasters, polynomials and rays."""
