"""The effects of all packages, as a scene has them."""
