"""The terminal: its output, its errors and the progress of a long command."""
