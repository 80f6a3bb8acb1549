"""What looks at whole recordings: calibration and smoothing; gtsam is imported only here."""
