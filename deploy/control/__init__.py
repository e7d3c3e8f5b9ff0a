"""Control plane of a running simulation: requests, server, client and discovery."""
