"""plant.kernels.exact."""
