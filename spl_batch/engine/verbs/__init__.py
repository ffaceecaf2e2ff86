"""Verbs of the command line, for any receiver."""
