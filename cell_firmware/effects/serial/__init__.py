"""Serial lines between neighbours: bytes with start and stop bits, timed at the sender's clock."""
