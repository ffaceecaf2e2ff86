"""What is looked at in a ground cell: its points, their classes, the pulses they belong to."""
