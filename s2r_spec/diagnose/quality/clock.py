"""A clock that runs too fast or too slowly: all channels undone by reading them at stretched times."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.quality.comparison import Comparison
from s2r_spec.diagnose.quality.finding import Finding
from s2r_spec.diagnose.quality.suspects import Suspect, refined

FloatArray = NDArray[np.float64]

FACTORS = tuple(np.geomspace(0.4, 2.5, 59).tolist())
"""Definition: real seconds that a stamped second may have been, before the best is refined. A rate that was set twice
as high as it was, or half as high, lies well inside; a best at either end is no minimum."""
STEADY = 0.005
"""Tolerance: a clock that is off by less is no mistake; clocks of computers are off by a hundredth of that."""


def clock(c: Comparison) -> list[Suspect]:
    """Return the clock that explains most, if it is a minimum; instants that are in no recording are not compared."""
    end = min(trace.duration for trace in c.traces)

    def there(stamped: float) -> FloatArray:
        return (stamped * c.times <= end)[:, None].astype(float)

    def loss(log: float) -> float:
        stamped = float(np.exp(log))
        values, counts = c.read(stretch=stamped), there(stamped)
        wrong = c.misfit(values, there=counts) - c.misfit(c.recorded, there=counts)
        return wrong if abs(stamped - 1.0) > STEADY else np.inf

    least = min(FACTORS, key=lambda stamped: loss(np.log(stamped)))
    if least in (FACTORS[0], FACTORS[-1]):
        return []
    log, step = np.log(least), np.log(FACTORS[1] / FACTORS[0])
    best = float(np.exp(refined(loss, log, log - step, log + step, 2)))
    step = float(np.median([np.median(np.diff(trace.times)) for trace in c.traces]))
    rate, was = 1.0 / step, best / step
    text = (
        f"all channels of the real rollouts, commands included, run {1.0 / best:.3g} times as fast as the simulator's. "
        f"Were samples taken at {was:.3g} Hz stamped at {rate:.3g} Hz?"
    )
    said = Finding("clock", "the clock", text, "a wrong clock")
    return [Suspect(said, c.read(stretch=best), None, there(best))]
