"""Smoothing of whole recordings."""
