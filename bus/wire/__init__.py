"""bus.wire."""
