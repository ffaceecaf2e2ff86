"""LAS, LAZ and COPC: read, written, converted."""
