"""Effects of the shape of the ground: a slope, and unevenness."""
