"""Tables in, tables out: noise along the track, signal and noise, profiles."""
