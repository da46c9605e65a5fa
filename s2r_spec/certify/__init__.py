"""Search, confidence sequences and certificates: a number with a probability."""
