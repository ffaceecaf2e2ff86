"""Base of all workflows: sections, checks, the file itself."""
