"""Chain of handlers around a tracker: second hypothesis, path, height, floor plan."""
