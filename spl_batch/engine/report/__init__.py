"""Base of all reports: model, page, maps, style, writing."""
