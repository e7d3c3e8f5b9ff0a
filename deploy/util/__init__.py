"""deploy.util."""
