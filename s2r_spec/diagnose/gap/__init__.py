"""The gap over the test space: its size, and whether it matters."""
