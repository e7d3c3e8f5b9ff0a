"""Orientations study: rest orientations of parcels at one place, for many sizes; text and plots."""
