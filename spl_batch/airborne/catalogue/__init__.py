"""What of a delivery other tools open at once: STAC, a virtual point cloud, an index."""
