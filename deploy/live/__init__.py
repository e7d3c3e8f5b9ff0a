"""Running simulations seen and controlled from outside: frames for viewers, and the client."""
