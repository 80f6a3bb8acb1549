"""Interacting multiple model: modes, motion model, trackers and weightings."""
