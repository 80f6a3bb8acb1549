"""Processing of whole recordings: calibration, smoothing and training. Only these modules import gtsam."""
