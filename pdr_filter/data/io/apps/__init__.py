"""Readers of the formats of single apps and data sets."""
