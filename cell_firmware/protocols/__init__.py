"""Bundled firmware, one a file, found by the file's name: no other modules here."""
