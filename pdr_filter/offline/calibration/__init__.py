"""Calibration of step-length parameters from walks of known length."""
