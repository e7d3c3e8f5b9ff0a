"""Checkpoints of a run, and resuming from a checkpoint."""
