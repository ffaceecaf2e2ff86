"""File formats: path to value and back, each checked before any library trusts it."""
