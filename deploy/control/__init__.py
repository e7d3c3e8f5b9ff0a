"""A run that is spoken to while it goes on: what can be asked, who asks, who answers."""
