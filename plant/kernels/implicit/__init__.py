"""plant.kernels.implicit."""
