"""Step-length models, their fits, and the step length of one person."""
