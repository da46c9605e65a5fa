"""Where the gap lies, whether it matters, and how far it shrinks."""

LEVEL = 0.05
"""Level: probability of each false answer: a material gap where there is none, a shift of a residual or unexplained
motion that is not there, an interval or a band that misses."""
DRAWS = 2000
"""Budget: resamples of a bootstrap, and functions sampled from a posterior."""
FEWEST = 5
"""Tolerance: rollouts that reach a place, or degrees of freedom, from which on scatter is known to a third."""
SHOTS = 3
"""Budget: simulated rollouts of a held-out test, and tests at which effects and variants are tried. At every test the
nominal simulator has twice as many rollouts, so that single real failures at two tests are more than chance if no
simulated rollout fails."""
ROUNDING = 1e-7
"""Tolerance: rounding error of ρ and of residuals, in parts of the largest value, and of probabilities."""
