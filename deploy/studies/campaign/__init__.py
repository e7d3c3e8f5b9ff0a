"""Campaigns: many runs of a scene over seeds, faults and parameters."""
