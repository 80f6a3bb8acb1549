"""Floor plans, and the particle filter that keeps a track inside of them."""
