"""Step detectors: causal stages that turn specific force into steps."""
