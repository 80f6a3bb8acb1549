"""Classifiers as plain arrays: prediction, model files, the relevance vector machine, and transition probabilities."""
