"""Faults of cells, one module each: faults of programs, sensors and links."""
