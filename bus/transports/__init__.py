"""The transports, one a file."""
