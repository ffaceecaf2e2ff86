"""Bare arrays in, bare arrays out: numba or numpy; no I/O, no dask, no classes."""

from spl_batch.kernels.code_cache import install

install()
