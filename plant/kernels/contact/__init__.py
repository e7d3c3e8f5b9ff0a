"""plant.kernels.contact."""
