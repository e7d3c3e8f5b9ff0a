"""plant.kernels.effects."""
