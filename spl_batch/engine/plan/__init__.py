"""Plans of any receiver: input files, memory of workers, cost."""
