"""Step-length parameters from walks of known length."""
