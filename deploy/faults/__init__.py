"""Faults of a scene: fault kinds for cells and plant together, and the registry of all kinds."""
