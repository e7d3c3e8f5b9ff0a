"""plant.faults.kinds."""
