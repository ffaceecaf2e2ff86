"""The altimetry receiver: photon profiles along a track [W17 ch. 4], ``kind: altimetry``."""
