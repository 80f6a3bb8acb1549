"""State of one pedestrian: estimates, frame of the fixes, history of steps and fixes, person."""
