"""Where the gap lies: in the test space, in time and formula, and in the machine."""
