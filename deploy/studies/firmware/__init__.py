"""Checks of a program of cells: what makes its results depend on how it is run."""
