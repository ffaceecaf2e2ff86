"""Synthetic surveys with point-level truth [W17 ch. 2]."""
