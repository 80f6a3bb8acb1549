"""Floor plans and radio maps, and the particle filter that keeps a track on a floor plan."""
