"""Tiles: blocks of cells that act as one, and pass parcels on from one to the next."""
