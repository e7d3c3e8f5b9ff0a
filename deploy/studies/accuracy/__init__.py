"""What accuracy costs: every solver on one scene, against a reference of another method."""
