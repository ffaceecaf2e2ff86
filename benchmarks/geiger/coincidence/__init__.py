"""Coincidence processing against its known scene."""
