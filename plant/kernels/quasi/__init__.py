"""plant.kernels.quasi."""
