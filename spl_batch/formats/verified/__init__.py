"""Tables and arrays in which a damaged byte is noticed."""
