"""Faults of the plant's parts, one a file: of wheels, and of whole cells that are gone."""
