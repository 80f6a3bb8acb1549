"""What needs the whole recording: smoothing, and calibration. Nothing here runs in an app."""
