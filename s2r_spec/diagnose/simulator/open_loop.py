"""A simulator that plays what was recorded at each test, instead of its controller's commands.

A controller hides physics in its feedback, and a log of joints may have no controller at all. Its recorded commands are
then the input of the simulator, as they were that of the machine: what differs is physics. The test of a recording is
the key to its commands; at another test, those of the nearest recording are played.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from s2r_spec.backend import (
    Backend,
    Channel,
    Effect,
    Finding,
    HasChosen,
    HasEffects,
    HasLoop,
    HasResiduals,
    HasVariants,
    LoopMistake,
    Parameter,
)
from s2r_spec.backend.protocols import PLAYED, PROTOCOL, HasInputs, HasProtocols, Protocol, run_protocol
from s2r_spec.base.errors import TraceError, UsageError
from s2r_spec.diagnose.simulator.axes import Values
from s2r_spec.recordings.log_episodes import PART_OF_LOG
from s2r_spec.spec import Spec
from s2r_spec.trace import Trace
from s2r_spec.trace.samples import period_of

LEAD = 0.5
"""Budget: time of the log before a part of it that is played, too [s], so that the part begins in the simulator's own
state; a servo forgets within a few kd/kp, which is a tenth of a second."""


@dataclass(frozen=True, eq=False)
class OpenLoop:
    """A backend whose test is a recording.

    Attributes:
        base: plays recorded inputs.
        parameters: of the specification.
        inputs: (test, its recording) of each.
        digest: hash of all recordings.
    """

    base: Backend
    parameters: tuple[Parameter, ...]
    inputs: tuple[tuple[Mapping[str, float], Trace], ...]
    digest: str
    deterministic: bool = True

    @classmethod
    def of(cls, base: Backend, spec: Spec, inputs: tuple[tuple[Mapping[str, float], Trace], ...]) -> Self:
        """Return the simulator of recordings at tests of a specification.

        Raises:
            UsageError: the simulator plays no recorded inputs, or two recordings are of one test.
        """
        if not isinstance(base, HasInputs):
            raise UsageError(f"the backend {base.name!r} plays no recorded commands; it needs a method play")
        names = spec.space.names
        keys = [tuple(test[name] for name in names) for test, _ in inputs]
        if len(set(keys)) < len(keys):
            raise UsageError(
                f"two recordings have the same {', '.join(names)}, so their commands cannot be told apart; "
                f"give each a parameter of its own"
            )
        parameters = tuple(
            Parameter(axis.name, axis.unit, axis.low, axis.high, axis.low, "of the recording")
            for axis in spec.space.axes
        )
        return cls(base, parameters, inputs, _digest(inputs), base.deterministic)

    @property
    def name(self) -> str:
        """Name of the simulator."""
        return self.base.name

    @property
    def channels(self) -> tuple[Channel, ...]:
        """The channels of the simulator."""
        return self.base.channels

    @property
    def duration(self) -> float:
        """Duration of the longest recording [s]."""
        return max(trace.duration for _, trace in self.inputs)

    @property
    def cost(self) -> float:
        """Expected time of a rollout on one core [s]."""
        return self.base.cost * (self.duration + LEAD) / self.base.duration

    @property
    def model_hash(self) -> str:
        """Hash of the simulator and of the recordings."""
        return f"{self.base.model_hash} {self.digest}"

    def rollout(self, params: Mapping[str, float], seed: int) -> Trace:
        """Play the commands that were recorded at a test."""
        assert isinstance(self.base, HasInputs)
        test, recorded = self._nearest(params)
        before = self._before(test, recorded)
        lead = 0.0 if before is None else before.duration
        whole = recorded if before is None else _joined(before, recorded)
        played = self.base.play(whole, {}, seed)
        trace = played if before is None else _from(played, lead)
        meta = {key: value for key, value in trace.meta.items() if key != PROTOCOL}
        return replace(trace, meta=meta | {"params": dict(params)})

    def _before(self, test: Mapping[str, float], recorded: Trace) -> Trace | None:
        """Return the end of the part of the same log before a recording; None where there is none."""
        if PART_OF_LOG not in test:
            return None
        others = {name: value for name, value in test.items() if name != PART_OF_LOG}
        for other, trace in self.inputs:
            ends = other[PART_OF_LOG] + trace.duration
            same = all(other[name] == value for name, value in others.items())
            if (
                same
                and abs(ends - test[PART_OF_LOG]) < 1.5 * period_of(trace.times)
                and trace is not recorded
            ):
                return trace.between(max(trace.times[-1] - LEAD, trace.times[0]), trace.times[-1])
        return None

    def protocols(self) -> tuple[Protocol, ...]:
        """Return the simulator's protocols, which may run beside the recordings."""
        return self.base.protocols() if isinstance(self.base, HasProtocols) else ()

    def run(self, protocol: str, params: Mapping[str, float], seed: int) -> Trace:
        """Run a protocol of the simulator."""
        return run_protocol(self.base, protocol, params, seed)

    def _nearest(self, params: Mapping[str, float]) -> tuple[Mapping[str, float], Trace]:
        def away(test: Mapping[str, float]) -> float:
            return sum(
                ((test[p.name] - params.get(p.name, p.default)) / (p.high - p.low)) ** 2
                for p in self.parameters
            )

        return min(self.inputs, key=lambda one: away(one[0]))

    def residuals(self, trace: Trace, params: Mapping[str, float] | None = None) -> Trace:
        """Return the simulator's residuals of a run that plays recorded commands, or of a protocol."""
        if not isinstance(self.base, HasResiduals):
            raise TraceError(f"{self.name} has no residuals")
        if trace.meta.get(PROTOCOL):
            return self.base.residuals(trace, params)
        return self.base.residuals(replace(trace, meta=dict(trace.meta) | {PROTOCOL: PLAYED}), {})

    def loop(self, trace: Trace) -> list[Finding]:
        """Return what the simulator's files say of the loop of a run that plays recorded commands."""
        played = replace(trace, meta=dict(trace.meta) | {PROTOCOL: PLAYED})
        return list(self.base.loop(played)) if isinstance(self.base, HasLoop) else []

    def replayed(self, traces: Sequence[Trace]) -> None:
        """Return no loop: none is closed here."""

    def as_logged(self, traces: Sequence[Trace]) -> Self:
        """Return this simulator: its channels have one convention."""
        return self

    def mistakes(self) -> dict[LoopMistake, Self]:
        """Return no mistakes of a loop."""
        return {}

    def with_mistakes(self, mistakes: Sequence[LoopMistake]) -> Self:
        """Return this simulator."""
        return self

    def effects(self) -> tuple[Effect, ...]:
        """Return the simulator's catalogue."""
        return self.base.effects() if isinstance(self.base, HasEffects) else ()

    def with_effects(self, values: Values) -> Self:
        """Return the same recordings with effects in the simulator."""
        assert isinstance(self.base, HasEffects)
        return replace(self, base=self.base.with_effects(values))

    def chosen(self) -> Values:
        """Return the effects of the simulator."""
        return self.base.chosen() if isinstance(self.base, HasChosen) else {}

    def variants(self) -> dict[str, Self]:
        """Return the variants of the simulator."""
        if not isinstance(self.base, HasVariants):
            return {}
        return {name: replace(self, base=one) for name, one in self.base.variants().items()}


def _joined(first: Trace, second: Trace) -> Trace:
    """Return two parts of a log, one after the other, with the channels of both; they share a sample."""
    names = [name for name in first.channels if name in second.channels]
    earlier = first.times < first.times[-1]
    times = np.concatenate(
        [first.times[earlier] - first.times[0], second.times - second.times[0] + first.duration]
    )
    channels = {name: np.concatenate([first[name][earlier], second[name]]) for name in names}
    return Trace(times, channels, {name: first.units[name] for name in names if name in first.units})


def _from(trace: Trace, begin: float) -> Trace:
    """Return a trace from the sample next to a time on, with times from 0 on."""
    row = int(np.abs(trace.times - begin).argmin())
    channels = {name: values[row:] for name, values in trace.channels.items()}
    return Trace(trace.times[row:] - trace.times[row], channels, trace.units, trace.meta)


def _digest(inputs: tuple[tuple[Mapping[str, float], Trace], ...]) -> str:
    from hashlib import sha256

    total = sha256()
    for test, trace in inputs:
        total.update(repr(sorted(test.items())).encode() + np.ascontiguousarray(trace.times).tobytes())
        for name in sorted(trace.channels):
            total.update(name.encode() + np.ascontiguousarray(trace[name]).tobytes())
    return total.hexdigest()[:16]
