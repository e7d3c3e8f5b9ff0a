"""Security of a run's bus: roles, certificates or passwords, and access control."""
