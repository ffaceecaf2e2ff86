"""Signal and noise: scores of photons, thresholds, photons kept by chance."""
