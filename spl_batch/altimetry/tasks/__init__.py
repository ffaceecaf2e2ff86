"""Tasks on photon profiles: files, beams, segments of track, profiles, delivery."""
