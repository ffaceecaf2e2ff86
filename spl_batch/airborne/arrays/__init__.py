"""Numpy arrays in metres in, labels and rasters out: the survey's steps without files."""
