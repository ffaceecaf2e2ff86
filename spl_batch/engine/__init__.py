"""Engine of every receiver: tasks, receipts, workers, verbs, and the report of a run."""
