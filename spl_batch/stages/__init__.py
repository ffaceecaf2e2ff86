"""Tables in, tables out; each module says its domain, columns and reach."""
