"""Memory of tasks: the heaviest of a survey, and cells that are done in strips."""
