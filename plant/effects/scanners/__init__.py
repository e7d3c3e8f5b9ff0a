"""plant.effects.scanners."""
