"""Features of windows of samples: what a context classifier sees."""
