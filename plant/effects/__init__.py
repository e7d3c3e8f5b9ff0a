"""Optional physics of the plant: one effect a package or module, active only in scenes that configure it."""
