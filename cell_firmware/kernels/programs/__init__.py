"""Compiled steps of bundled programs."""
