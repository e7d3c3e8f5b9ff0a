"""Effects, one a file: what cells have only where a scene asks for it."""
