"""Raw single-photon lidar surveys to clean point clouds and terrain, whole surveys overnight."""

__version__ = "0.1.0"
