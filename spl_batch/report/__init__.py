"""Statistics to one JSON and one HTML that opens offline."""
