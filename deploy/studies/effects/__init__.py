"""Effects study: influence and cost of a scene's effects, one at a time and as a ladder of fidelity."""
