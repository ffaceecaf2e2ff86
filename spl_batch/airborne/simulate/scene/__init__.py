"""Scene of a simulated survey: terrain, objects, rays against them."""
