"""The report of ``kind: altimetry``."""
