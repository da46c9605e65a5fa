"""The gap: whether it matters, at the tests that were run, over the test space, and in the parts of the machine."""
