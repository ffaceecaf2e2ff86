"""Arrays and numbers in, arrays out."""
