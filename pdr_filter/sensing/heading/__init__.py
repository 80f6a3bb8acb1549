"""Heading stages: the walking direction of each step, and the direction of north."""
