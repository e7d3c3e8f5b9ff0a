"""What protocols are built of: neighbours' last words, places, ways, spectra; no protocol, and nothing of a board."""
