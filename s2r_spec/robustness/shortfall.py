"""The time that a trace is too short for a formula, in words."""

from __future__ import annotations

import math

from s2r_spec.lang import formula as f
from s2r_spec.robustness.deciding import descend
from s2r_spec.robustness.evaluate import Walk
from s2r_spec.robustness.evaluation import Reading
from s2r_spec.robustness.horizon import horizon
from s2r_spec.robustness.numbers import SampledSignals
from s2r_spec.robustness.sampled import SampledAlgebra


def shortfall(formula: f.Formula, reading: Reading) -> str:
    """Return the end of a sentence on a requirement that the trace does not decide: "looks 2 s ahead, but …".

    The instant in it would decide ρ if windows were cut at the end of the trace.
    """
    ahead = horizon(formula)
    times = reading.times
    length = f"the trace lasts {times[-1] - times[0]:.6g} s"
    if len(times) == 1:
        length = "the trace has one sample"
    if 0 < ahead < math.inf:
        return f"looks {ahead:g} s ahead, but {length}"
    if ahead == 0:
        return f"looks at the next sample, but {length}"
    if len(times) == 1:
        return f"looks at the whole rest of a trace, but {length}"
    algebra = SampledAlgebra(SampledSignals(reading.clock, reading.signals, reading.params, reading.until))
    walk = Walk(algebra, reading.until)
    walk(formula)
    longest = reading.needs(formula), 0
    for step in descend(formula, walk, reading.clock):
        reach = reading.needs(step.node)
        if reach > 0 and times[step.sample] + reach > times[-1]:
            longest = reach, step.sample
    reach, sample = longest
    return (
        f"looks {reach:g} s past t = {float(times[sample] - times[0]):.6g} s, "
        f"but the trace ends at {float(times[-1] - times[0]):.6g} s"
    )
