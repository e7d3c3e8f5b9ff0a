"""Traction laws, one a file."""
