"""Step detectors, the gate against false steps, and the smoothing of contact times."""
