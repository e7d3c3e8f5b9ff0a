"""plant.effects.analogue_sensors."""
