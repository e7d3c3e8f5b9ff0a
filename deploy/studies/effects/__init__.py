"""What effects of a scene do and cost: one at a time, and as a ladder of fidelity."""
