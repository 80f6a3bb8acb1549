"""Sliding windows of samples and their features."""
