"""Recordings: written so that a cut loses little, read back whole or cut."""
