"""Ground by a surface whose scale follows the data."""
