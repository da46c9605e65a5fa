"""Times of a log: its stamps, dates, durations and their units."""
