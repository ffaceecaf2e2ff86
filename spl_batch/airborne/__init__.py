"""Airborne single-photon lidar: from flightlines to clouds, terrain and a report."""
