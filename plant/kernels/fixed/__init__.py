"""plant.kernels.fixed."""
