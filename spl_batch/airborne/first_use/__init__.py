"""From files to a first result: what they tell of a survey, without a workflow file."""
