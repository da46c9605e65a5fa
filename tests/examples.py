"""How many random examples a property is tried on.

A run of the suite tries a fifth of what a test states, the same ones every time, so that it passes again where
it passed before; ``S2R_EXAMPLES=1`` tries as many as stated, other ones every time, and 10 ten times as many.
"""

import os

PART = float(os.environ.get("S2R_EXAMPLES", "0.2"))
"""Part of the stated examples (dimensionless, a budget): twice as much takes the properties twice as long."""


def examples(stated: int) -> int:
    """Return how many of so many examples are tried now, at least one."""
    return max(1, round(PART * stated))
