"""Exports of recordings to the formats of other tools, one a file."""
