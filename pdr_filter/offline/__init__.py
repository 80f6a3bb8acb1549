"""Processing of whole recordings: calibration, smoothing and training. Only this package imports gtsam."""
