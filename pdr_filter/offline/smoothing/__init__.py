"""Tracks in hindsight."""
