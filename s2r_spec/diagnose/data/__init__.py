"""Data of a diagnosis: recorded and run experiments, the campaign that runs them, and the tests that are held out."""
