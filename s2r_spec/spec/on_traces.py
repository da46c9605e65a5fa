"""How a specification reads a trace: samples at common times, or messages of each signal with stamps of their own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from os import PathLike
from typing import TYPE_CHECKING, Any

from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.errors import TraceError, UndecidedError, UsageError
from s2r_spec.lang import formula as f
from s2r_spec.lang.amounts import Amount
from s2r_spec.robustness.binding import bind, names
from s2r_spec.robustness.evaluate import Witness
from s2r_spec.robustness.evaluation import End, Evaluation, Interpolation, Reading
from s2r_spec.robustness.grid import sent_on_change
from s2r_spec.robustness.reading import Missing, read_params, read_signals, read_streams
from s2r_spec.robustness.ticks import clock_of
from s2r_spec.spec.declared import Declared
from s2r_spec.trace import Trace

if TYPE_CHECKING:  # most traces have common samples, and are recorded
    from s2r_spec.robustness.judge import Judge
    from s2r_spec.robustness.online.recorder import Followed

_CHOICES: Mapping[str, tuple[str | None, ...]] = {
    "end": ("clip", "hold", "nan", "error"), "interpolation": (None, "samples", "hold", "linear"),
    "until": ("open", "closed"), "nan": ("error", "hold"),
}  # fmt: skip


@dataclass(frozen=True)
class How:
    """How a trace is evaluated; for the fields see :meth:`s2r_spec.spec.Spec.evaluate`.

    Raises:
        UsageError: a choice is none of those that there are.
    """

    params: Mapping[str, Amount] | None = None
    interpolation: Interpolation | None = None
    until: Witness = "open"
    nan: Missing = "error"
    partial: bool = False
    sparse: bool = False
    end: End = "clip"

    def __post_init__(self) -> None:
        """Check the choices."""
        for name, choices in _CHOICES.items():
            if (value := getattr(self, name)) not in choices:
                raise UsageError(
                    f"{name}={value!r} is not one of {', '.join(map(repr, filter(None, choices)))}"
                )


class OnTraces(Declared):
    """A specification as it reads traces."""

    def own_trace(self, trace: Trace, requirement: str) -> Trace:
        """Return the trace that a requirement reads: of messages, without the stamps of signals that it does not read.

        Raises:
            TraceError: a channel is missing.
        """
        trace = as_trace(trace)
        if trace.messages:
            messages = trace.only(self.channels(requirement))
            own = messages.common()
            return own if own.messages or not sent_on_change(own.times) else replace(own, origin=messages)
        return trace if trace.origin is None else trace.only(self.channels(requirement)).known()

    def needs_samples(self, requirement: str, messages: Trace) -> bool:
        """Return whether some part of a requirement has no value between common samples of its messages."""
        from s2r_spec.robustness.held import needs_samples

        times = {name: one.times for name, one in messages.messages.items()}
        return needs_samples(self.formulas[requirement], times)

    def contradicts(self, messages: Trace, requirement: str, satisfied: bool, how: How) -> bool:
        """Return whether all messages contradict a verdict at samples, whatever is known at samples alone."""
        own = messages.only(self.channels(requirement))
        judge, formula = self._judge(own, requirement, How(how.params, nan=how.nan))
        return judge.contradicts(formula, satisfied)

    def _read(self, trace: Trace, requirement: str, how: How) -> tuple[Reading | Judge, f.Formula]:
        """Return what a requirement reads of its own trace, and its formula with numbers for time bounds.

        Raises:
            SamplingError: a window is shorter than the time between two samples, and ``how`` is not sparse.
        """
        reader: Reading | Judge
        if trace.messages:
            reader, formula = self._judge(trace, requirement, how)
        else:
            reader = self._reading(trace, requirement, how)
            formula = reader.bound(self._formula(requirement))
        if not how.sparse:
            reader.refuse_short(formula)
        return reader, formula

    def _evaluate(self, trace: Trace, requirement: str, how: How) -> Evaluation:
        reader, formula = self._read(self.own_trace(trace, requirement), requirement, how)
        return reader.evaluate(formula, requirement, self.unit(requirement), how.end)

    def _reading(self, trace: Trace, requirement: str | None, how: How) -> Reading:
        """Return the samples that a requirement (or any) reads."""
        trace = as_trace(trace)
        numbers = self._numbers(self._given(trace, how), requirement)
        signals = read_signals(
            trace, tuple(self.signals[name] for name in self.channels(requirement)), how.nan
        )
        interpolation = how.interpolation or "samples"
        return Reading(trace.times, signals, numbers, interpolation, how.until, clock_of(trace.times))

    def _judge(self, trace: Trace, requirement: str, how: How) -> tuple[Judge, f.Formula]:
        """Return the judge of a trace of messages, and the formula with numbers for time bounds."""
        from s2r_spec.robustness.judge import Judge

        if how.interpolation == "samples":
            raise UsageError(
                f"{requirement!r} reads signals with stamps of their own, which have no common samples: resample the "
                f"trace, or give --clock with a topic"
            )
        numbers = self._numbers(self._given(trace, how), requirement)
        signals = [self.signals[name] for name in self.channels(requirement)]
        linear = {signal.name for signal in signals if how.interpolation == "linear" and not signal.boolean}
        streams = read_streams(signals, trace, how.nan, linear)
        judge = Judge(streams, numbers, trace.since, trace.ends, how.until)
        return judge, bind(self._formula(requirement), {name: one.item() for name, one in numbers.items()})

    def _given(self, trace: Trace, how: How) -> Mapping[str, Amount]:
        return {**self.recorded_params(trace.meta), **(how.params or {})}

    def _numbers(self, params: Mapping[str, Amount] | None, requirement: str | None) -> dict[str, FloatArray]:
        """Return name → (1, 1) of the parameters that a requirement (or any) uses."""
        used = {name for formula in self._chosen(requirement) for name in names(formula).params}
        return read_params(self.params, used, params or {})

    def _follow(
        self,
        params: Mapping[str, Amount] | None,
        requirement: str | None,
        period: float | None,
        until: Witness,
        nan: Missing,
        sparse: bool,
        ranges: bool,
    ) -> Followed:
        from s2r_spec.robustness.online.recorder import Followed

        How(until=until, nan=nan)  # a check
        numbers = {name: value.item() for name, value in self._numbers(params, requirement).items()}
        requirements = self.requirements if requirement is None else (requirement,)
        formulas = {name: bind(self._formula(name), numbers) for name in requirements}
        signals = [self.signals[name] for name in self.channels(requirement)]
        return Followed(formulas, signals, numbers, period, until, nan, ranges, sparse)

    def _fallen(self, requirement: str, failure: str) -> float:
        settings = self.certify.get(requirement)
        if settings is None or settings.fall is None:
            raise UsageError(
                f"the trace ended with {failure!r}, but {self.name} declares no ρ for a failure; "
                f"add a line such as `certify {requirement}: fall = -1`"
            )
        return settings.fall

    def _at_start(self, trace: Trace, requirements: Sequence[str], how: How) -> dict[str, float]:
        """Return requirement → ρ at the first time, never 0: its sign is the verdict."""
        if trace.messages or trace.origin is not None:
            return {name: self._of_own(self.own_trace(trace, name), name, how) for name in requirements}
        reading = self._reading(trace, requirements[0] if len(requirements) == 1 else None, how)
        return {name: self._of_samples(reading, name, how) for name in requirements}

    def _of_own(self, own: Trace, requirement: str, how: How) -> float:
        """Return ρ of one requirement at the begin of the trace that it reads, never 0."""
        if own.messages:
            return self._at_instants(own, requirement, how)
        rho = self._of_samples(self._reading(own, requirement, how), requirement, how)
        if own.origin is not None:
            self._refuse_other_verdict(own.origin, requirement, rho, how)
        return rho

    def _of_samples(self, reading: Reading, requirement: str, how: How) -> float:
        """Return ρ of one requirement at the first sample, never 0."""
        formula = reading.bound(self.formulas[requirement])
        reading.refuse_short(formula)
        if how.partial:
            return reading.at_first_sample(formula)
        refuse_short_trace(reading, formula, requirement)
        bounds = reading.bounds(formula)
        if bounds is None:
            return reading.at_first_sample(formula)
        low, high = bounds
        if low != high:
            raise UndecidedError(
                f"{requirement!r} depends on a gap without samples; ρ lies in [{low:.6g}, {high:.6g}]"
            )
        return low

    def _at_instants(self, own: Trace, requirement: str, how: How) -> float:
        """Return ρ of one requirement at the begin of a trace of messages that it reads, at every instant, never 0."""
        judge, formula = self._judge(own, requirement, how)
        judge.refuse_short(formula)
        judgement = judge.judge(formula, how.partial)
        if not (judgement.complete or how.partial):
            raise _too_short(judge, formula, requirement)
        if judgement.satisfied is None or (judgement.lower != judgement.upper and not judgement.several):
            why = judgement.open or "is not known exactly: a signal was silent, or began after the log"
            raise UndecidedError(f"{requirement!r} {why}")
        return judgement.signed

    def _refuse_other_verdict(self, messages: Trace, requirement: str, rho: float, how: How) -> None:
        """Refuse ρ at the stamps of one topic where every instant decides otherwise.

        Raises:
            UndecidedError: they do.
        """
        own = messages.only(self.channels(requirement))
        if self.needs_samples(requirement, own):
            if self.contradicts(own, requirement, rho > 0, how):
                raise UndecidedError(
                    f"{requirement!r} has ρ = {rho:.6g} at the samples; all messages contradict it"
                )
            return
        every = self._at_instants(own, requirement, replace(how, interpolation=None, partial=True))
        if (every > 0) != (rho > 0):
            raise UndecidedError(
                f"{requirement!r} has ρ = {rho:.6g} at the samples, and {every:.6g} at every instant"
            )


def refuse_short_trace(reading: Reading, formula: f.Formula, requirement: str) -> None:
    """Refuse samples that do not reach a formula's horizon.

    Raises:
        TraceError: they do not.
    """
    if not reading.complete_at_first_sample(formula):
        raise _too_short(reading, formula, requirement)


def _too_short(reader: Reading | Judge, formula: f.Formula, requirement: str) -> TraceError:
    return TraceError(
        f"{requirement!r} {reader.shortfall(formula)}; "
        f"give a longer trace, or set partial=True to cut windows at the end of this one"
    )


def as_trace(trace: Any) -> Trace:
    """Return a trace, also of a data frame.

    Raises:
        TraceError: it is another value.
    """
    if isinstance(trace, Trace):
        return trace
    if hasattr(trace, "columns"):
        return Trace.from_dataframe(trace)
    path = isinstance(trace, str | PathLike)
    remedy = "s2r.read_trace(path) reads one" if path else "s2r.Trace makes one"
    raise TraceError(f"a trace is needed, not a value of type {type(trace).__name__}; {remedy}")
