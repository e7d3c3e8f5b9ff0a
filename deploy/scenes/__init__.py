"""Scenes: the specifications of all packages composed, loaded and checked."""
