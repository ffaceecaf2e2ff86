"""Ground methods, against truth and published samples."""
