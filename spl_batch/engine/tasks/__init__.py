"""Tasks and their receipts: what to do, what is finished, what is left."""
