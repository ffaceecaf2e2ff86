"""Tables in, tables out; each module says its domain, reach and bytes per point."""
