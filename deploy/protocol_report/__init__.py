"""What a protocol did in a run: residuals, rate against theory, load on its links, its field as a picture."""
