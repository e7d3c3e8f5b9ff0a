"""How parcels come to lie: at one place, for many sizes; in words and pictures."""
