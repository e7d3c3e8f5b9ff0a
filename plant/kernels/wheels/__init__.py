"""plant.kernels.wheels."""
