"""Fitting of the shipped models."""
