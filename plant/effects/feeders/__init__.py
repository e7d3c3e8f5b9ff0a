"""plant.effects.feeders."""
