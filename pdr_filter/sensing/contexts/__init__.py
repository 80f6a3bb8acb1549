"""Context stages: context and carrying-mode probabilities of windows."""
