"""Faults of a scene: those that concern cells and plant alike, all of them by name, and when they act."""
