"""Certified worst cases: the search, its bounds, and the runs that answer it."""
