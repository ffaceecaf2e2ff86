"""Engine of every receiver: tasks, receipts, workers, verbs, and what is told of a run."""
