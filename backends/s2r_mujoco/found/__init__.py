"""What a diagnosis found, written back in the words of the user's own files."""
