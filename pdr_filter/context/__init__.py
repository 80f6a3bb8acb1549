"""Context classifiers: windows of features in, context probabilities out."""
