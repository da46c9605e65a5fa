"""The A1 backend."""
