"""Mistakes that the controller's own law shows: exactly, and without a simulation.

Data: n recordings y_i with commands u_i (T_i, m). The simulator knows the law u = κ(y) of its controller
(:class:`s2r_spec.backend.HasControlLaw`), which is the same on the machine. Unknown: a mistake g of a family: two
columns of one unit exchanged, or a channel of the opposite sign. Model:

    κ(g⁻¹(y_i)) = g⁻¹(u_i) + ε_i,    rms ε ≤ FLOOR · range(u)

Estimator: the g of least rms ε, over all recordings and the command that shows it best. It is a finding where the law
holds with g undone, fails as recorded, and no more than CLEAR of the error is left. Physics has no part in it: a
machine with any effect obeys its own controller's law.

Units: ε in parts of a command's range. Source: parity relations (Gertler 1998, ch. 5; Isermann 2006, §10).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from s2r_spec.backend import HasControlLaw
from s2r_spec.base.arrays import FloatArray
from s2r_spec.diagnose.data.space_filling import TESTS
from s2r_spec.diagnose.quality.comparison import CLEAR, FLOOR
from s2r_spec.diagnose.quality.finding import Finding
from s2r_spec.diagnose.quality.recordings import Recordings, as_columns
from s2r_spec.diagnose.simulator.bench import TestRun
from s2r_spec.trace import Trace

Undo = Callable[[Trace], Trace]


@dataclass(frozen=True)
class _Candidate:
    """A mistake, the channels with it, and how it is undone."""

    code: str
    names: tuple[str, ...]
    undo: Undo


def by_law(of: Recordings) -> list[Finding]:
    """Return the mistake that the controller's law shows, if there is one."""
    backend = of.bench.backend
    if not isinstance(backend, HasControlLaw):
        return []
    runs = [run for run in of.rollouts if run[1].failure is None][:TESTS]
    recorded = errors(backend, runs, lambda trace: trace)
    broken = [name for name, error in recorded.items() if error > FLOOR]
    if not broken:
        return []
    undone = [(errors(backend, runs, one.undo), one) for one in _candidates(of, runs)]
    tried = [
        (error[name], name, one)
        for error, one in undone
        for name in broken
        if error.get(name, np.inf) <= min(FLOOR, CLEAR * recorded[name])
    ]
    if not tried:
        return []
    left, name, one = min(tried, key=lambda each: each[0])
    return [_finding(one, name, recorded[name], left)]


def errors(backend: HasControlLaw, runs: Sequence[TestRun], undo: Undo) -> dict[str, float]:
    """Return command → rms difference from the law over all recordings, in parts of the command's range."""
    differences: dict[str, list[FloatArray]] = {}
    values: dict[str, list[FloatArray]] = {}
    for test, trace in runs:
        recorded = undo(trace)
        law = backend.commands(recorded, test)
        for name in law.channels:
            there, here = as_columns(law, name), as_columns(recorded, name)
            known = np.isfinite(there) & np.isfinite(here)
            differences.setdefault(name, []).append((here - there)[known])
            values.setdefault(name, []).append(here[known])
    found = {}
    for name, parts in differences.items():
        every, reach = np.concatenate(parts), float(np.ptp(np.concatenate(values[name]))) if parts else 0.0
        if every.size and reach > 0.0:
            found[name] = float(np.sqrt((every**2).mean())) / reach
    return found


def _candidates(of: Recordings, runs: Sequence[TestRun]) -> Iterator[_Candidate]:
    channels = [
        one
        for one in of.bench.backend.channels
        if one.width == 1 and all(one.name in trace for _, trace in runs)
    ]
    for first, second in combinations(channels, 2):
        if first.unit == second.unit:
            yield _Candidate("exchanged", (first.name, second.name), _exchange(first.name, second.name))
    for one in channels:
        yield _Candidate("sign", (one.name,), _turn(one.name))


def _exchange(first: str, second: str) -> Undo:
    other = {first: second, second: first}
    return lambda trace: trace.with_channels(
        lambda name, values: trace[other[name]] if name in other else values
    )


def _turn(name: str) -> Undo:
    return lambda trace: trace.with_channels(lambda one, values: -values if one == name else values)


def _finding(one: _Candidate, command: str, error: float, left: float) -> Finding:
    law = (
        f"the controller's law gives {command} from the other channels; as recorded it is off by {100 * error:.2g} % "
        f"of the range of {command} (rms), and by {100 * left:.1g} %"
    )
    if one.code == "sign":
        text = (
            f"{one.names[0]} of the real rollouts has the opposite sign: {law} with its sign changed. Change the sign "
            f"in the recordings"
        )
        return Finding("sign", one.names[0], text, "the opposite sign")
    words = " and ".join(one.names)
    text = f"{words} of the real rollouts are exchanged: {law} with both exchanged. Correct the names in the recordings"
    return Finding("exchanged", words, text, "an exchange of channels")
