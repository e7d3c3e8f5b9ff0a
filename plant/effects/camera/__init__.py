"""plant.effects.camera."""
