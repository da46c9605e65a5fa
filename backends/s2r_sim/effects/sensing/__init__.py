"""Effects of sensors and of the velocity estimate: offsets, biases and wrong scales."""
