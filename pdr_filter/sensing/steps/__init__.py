"""Step detectors of one interface, and the gate against false steps."""
