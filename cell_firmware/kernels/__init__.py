"""Compiled steps of what a cell's board does: scalar functions of one cell, and loops over the cells of a shard."""
