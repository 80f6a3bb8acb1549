"""Classifiers as plain arrays: predicting, the model files, the relevance vector machine, transitions of contexts."""
