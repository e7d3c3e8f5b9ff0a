"""Accuracy study: cost of accuracy for every solver on one scene, against an independent reference."""
