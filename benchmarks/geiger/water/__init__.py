"""Water surfaces against the source's figures."""
