"""Windows of samples and their features."""
