"""From files to a first result: what they show of a survey, without a workflow file."""
