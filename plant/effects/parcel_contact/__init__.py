"""Parcels that touch each other or guide rails: found without misses, reported or resolved."""
