"""Effects, one a file: physics that a scene has only where it asks for it."""
