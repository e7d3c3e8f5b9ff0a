"""Optional effects of the cells, one module each, enabled by a scene."""
