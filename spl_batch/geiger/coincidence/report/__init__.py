"""What a report on coincidence processing says, and its page."""
