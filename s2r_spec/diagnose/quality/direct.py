"""The checks that look at one channel at a time, with one simulated rollout beside each real one."""

from __future__ import annotations

from collections.abc import Sequence

from s2r_spec.diagnose.axes import Line
from s2r_spec.diagnose.quality.begin import commands, other_begin
from s2r_spec.diagnose.quality.comparison import Rollout
from s2r_spec.diagnose.quality.copied import copied
from s2r_spec.diagnose.quality.finding import Finding
from s2r_spec.diagnose.quality.opposite import other_sign
from s2r_spec.diagnose.quality.pairs import simulated
from s2r_spec.diagnose.quality.still import still
from s2r_spec.diagnose.quality.unit import other_unit, other_unit_of_one
from s2r_spec.diagnose.quality.wrapped import wrapped
from s2r_spec.diagnose.simulate import Bench


def direct(bench: Bench, rollouts: Sequence[Rollout], lines: Sequence[Line] = ()) -> list[Finding]:
    """Return what to say of each channel that has another unit, sign or begin than the simulator's, one finding each.

    And of "the tests", where one recording stands under two of them.

    Args:
        bench: the simulator.
        rollouts: the machine's.
        lines: of the catalogue; a channel that none of them moves is a command, and tells when a recording began.
    """
    pairs = simulated(bench, rollouts)
    if not pairs:
        return []
    real = [trace for _, trace in rollouts]
    first = next(test for test, trace in rollouts if trace.failure is None)
    found: dict[str, Finding] = {}
    for channel in bench.backend.channels:
        name = channel.name
        if text := still(name, pairs):
            found[name] = Finding("still", name, text)
        elif text := wrapped(channel, real, pairs):
            found[name] = Finding("wrapped", name, text)
        elif text := other_sign(channel, pairs):
            found[name] = Finding("sign", name, text, "the opposite sign")
        elif text := other_unit(channel, pairs):
            found[name] = Finding("unit", name, text, "another unit")
        elif text := other_unit_of_one(bench, channel, rollouts):
            found[name] = Finding("unit of one", name, text)
    if text := copied(bench, rollouts):
        found["the tests"] = Finding("copied", "the tests", text)
    for name in commands(bench, lines, first, pairs[0][0]):
        if text := other_begin(name, pairs):
            found[name] = Finding("begin", name, text, "a recording that begins at another time")
    return list(found.values())
