"""deploy.studies."""
