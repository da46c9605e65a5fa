"""Where the gap lies, whether it matters, and how far it shrinks."""

LEVEL = 0.05
"""Level: probability of each false answer: a material gap where there is none, a shift of a residual or unexplained
motion that is not there, an interval or a band that misses. Doubled, twice as many are false, and intervals of 20 tests
get 14 % shorter."""
DRAWS = 2000
"""Budget: resamples of a bootstrap, and functions sampled from a posterior. Doubled, the sampling error of every
probability is smaller by a factor √2."""
