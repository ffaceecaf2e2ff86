"""What a report says of noise that does not fit its model."""
