"""plant.analysis."""
