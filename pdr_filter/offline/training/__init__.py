"""Training of the shipped models, and of context models on other recordings."""
