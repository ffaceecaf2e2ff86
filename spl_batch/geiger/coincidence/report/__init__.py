"""Report on coincidence processing: its model and its page."""
