"""GeoTIFFs that are delivered, and parts of them."""
