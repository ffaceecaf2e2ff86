"""Tables and arrays that tell when a byte of them is damaged."""
