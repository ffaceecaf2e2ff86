"""Working store: its files and receipts, its links, its owner and its lock."""
