"""What every other room stands on: errors, verdicts, text, numbers, files, and what the package knows of itself."""
