"""Faults of cells, one a file: of their programs, their sensors, and the links between them."""
