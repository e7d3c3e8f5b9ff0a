"""Disk cache of compiled kernels, for every package that has some."""
