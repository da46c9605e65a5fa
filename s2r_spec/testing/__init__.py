"""Tests of traces and of backends: for users of pytest, and for authors of backends."""
