"""plant.kernels.common."""
