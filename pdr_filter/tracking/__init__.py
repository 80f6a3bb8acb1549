"""Sensing and filter as one: for apps that push samples, and for whole recordings."""
