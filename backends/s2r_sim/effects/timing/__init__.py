"""Effects of delay between controller and motors."""
