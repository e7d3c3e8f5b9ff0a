"""Solvers, one a file: how a parcel's motion is found."""
