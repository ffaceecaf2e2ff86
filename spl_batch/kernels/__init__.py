"""Bare arrays in, bare arrays out: numba or numpy; no I/O, no dask, no classes."""
