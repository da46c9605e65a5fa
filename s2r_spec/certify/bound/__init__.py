"""Bounds of the objective from outcomes: the declaration, the posterior, the confidence sequence, the certificate."""
