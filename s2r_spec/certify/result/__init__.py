"""The results of a check and of a gap, and what follows from them."""
