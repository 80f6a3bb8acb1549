"""Context and carrying-mode probabilities of windows, behind one interface."""
