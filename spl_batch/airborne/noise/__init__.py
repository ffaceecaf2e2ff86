"""Background noise: density along flightlines, in voxels, at points."""
