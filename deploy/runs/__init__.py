"""deploy.runs."""
