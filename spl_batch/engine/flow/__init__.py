"""Flow of tasks to workers; the only folder that imports dask."""
