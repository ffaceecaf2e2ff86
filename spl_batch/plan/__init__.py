"""From a survey to tasks: what there is, how it is cut, what it will cost."""
