"""The report of a water surface: its model, its page, its pictures."""
