"""Evaluation of a specification on traces: ρ, recorded or online, and its explanation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from s2r_spec.base.errors import TraceError, UndecidedError, UsageError
from s2r_spec.base.printable import one_line
from s2r_spec.lang import formula as f
from s2r_spec.lang.amounts import Amount
from s2r_spec.lang.declarations import Param, Signal
from s2r_spec.robustness.binding import bind, names
from s2r_spec.robustness.evaluate import Witness
from s2r_spec.robustness.evaluation import End, Evaluation, Interpolation, Reading, evaluate
from s2r_spec.robustness.explain import Explanation, explain
from s2r_spec.robustness.grid import sent_on_change
from s2r_spec.robustness.held import needs_samples
from s2r_spec.robustness.judge import Judge, Judgement
from s2r_spec.robustness.online.monitor import Followed, Monitor, RobustnessStream
from s2r_spec.robustness.reading import Missing, read_params, read_signals, read_streams
from s2r_spec.robustness.shortfall import shortfall
from s2r_spec.robustness.ties import restore_zero
from s2r_spec.robustness.tolerances import Tolerances, tolerances
from s2r_spec.spec.declared import Declared
from s2r_spec.spec.plot import Plot, draw
from s2r_spec.trace import Trace

if TYPE_CHECKING:
    from torch import Tensor

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class _How:
    """How a trace is evaluated; for the fields see :meth:`Spec.evaluate`.

    Raises:
        UsageError: a choice is none of those that there are.
    """

    params: Mapping[str, Amount] | None
    interpolation: Interpolation | None = None
    until: Witness = "open"
    nan: Missing = "error"
    partial: bool = False

    def __post_init__(self) -> None:
        """Check the choices."""
        if self.interpolation is not None:
            _choice("interpolation", self.interpolation, ("samples", "hold", "linear"))
        _choice("until", self.until, ("open", "closed"))
        _choice("nan", self.nan, ("error", "hold"))


class Spec(Declared):
    """A checked specification. Made by :func:`parse_spec` and :func:`load_spec`; can be pickled."""

    def __repr__(self) -> str:
        """Return one line: requirements, signals and parameters with their units."""
        signals, params = (
            ", ".join(map(_declaration_text, of.values())) for of in (self.signals, self.params)
        )
        with_params = f"; params {params}" if params else ""
        return one_line(
            f"Spec({self.name!r}: {', '.join(self.requirements)}; signals {signals or 'none'}{with_params})"
        )

    def robustness(
        self,
        trace: Trace,
        params: Mapping[str, Amount] | None = None,
        *,
        interpolation: Interpolation | None = None,
        until: Witness = "open",
        end: End | None = None,
        nan: Missing = "error",
        partial: bool = False,
        only: str | None = None,
    ) -> dict[str, float]:
        """Return requirement → ρ at the trace's first time, in the unit :meth:`unit`.

        ρ > 0: it holds, and keeps holding while every signal changes by less
        than ρ. ρ < 0: it is violated. ρ = 0: :meth:`satisfied` tells the two apart. A trace with a failure (a
        fall) has the ρ that the ``certify`` line declares for it, whatever its samples are.

        Args:
            trace: a trace with every channel of :meth:`channels`, or a data frame, as
                :meth:`s2r_spec.Trace.from_dataframe` reads it.
            params: name → value: a number in the declared unit, a text with a unit ("30 cm/s"), or a pint Quantity. A
                parameter without one has the value in ``trace.meta["params"]``, or else its default.
            interpolation: see :meth:`evaluate`.
            until: see :meth:`evaluate`.
            end: see :meth:`evaluate`; without it a trace that is shorter than the horizon is refused.
            nan: see :meth:`evaluate`.
            partial: evaluate such a trace with windows cut at its end, as ``end="clip"`` does.
            only: evaluate this requirement alone; the trace needs only the channels that it reads.

        Raises:
            TraceError: a channel is missing, has NaN or an unfit unit, a window is shorter than
                the time between two samples, or the trace is too short.
            UsageError: a parameter is missing or unknown, or the trace failed and the spec declares no ρ for a
                failure.
        """
        names = tuple(self.formulas) if only is None else (only,)
        trace = _as_trace(trace)
        if trace.failure is not None:
            return {name: self._fallen(name, trace.failure) for name in names}
        if end is not None:
            return {
                name: self.evaluate(
                    trace, name, params, nan=nan, interpolation=interpolation, until=until, end=end
                ).value
                for name in names
            }
        signed = self._at_start(trace, names, _How(params, interpolation, until, nan, partial))
        return {name: restore_zero(rho) for name, rho in signed.items()}

    def satisfied(
        self,
        trace: Trace,
        params: Mapping[str, Amount] | None = None,
        *,
        interpolation: Interpolation | None = None,
        until: Witness = "open",
        nan: Missing = "error",
        partial: bool = False,
        only: str | None = None,
    ) -> dict[str, bool]:
        """Return requirement → whether it is true at the trace's first time: the Boolean semantics.

        The sign of ρ decides. At ρ = 0 the comparisons decide: x <= c holds at x = c, and x < c does
        not. A trace with a failure satisfies nothing whose declared ``fall`` is not positive.

        For args and errors see :meth:`robustness`.
        """
        names = tuple(self.formulas) if only is None else (only,)
        trace = _as_trace(trace)
        if trace.failure is not None:
            return {name: self._fallen(name, trace.failure) > 0 for name in names}
        signed = self._at_start(trace, names, _How(params, interpolation, until, nan, partial))
        return {name: rho > 0 for name, rho in signed.items()}

    def _at_start(self, trace: Trace, requirements: Sequence[str], how: _How) -> dict[str, float]:
        """Return requirement → ρ at the first time, never 0: its sign is the verdict."""
        if trace.messages or trace.origin is not None:
            return {name: self._of_own(self.own_trace(trace, name), name, how) for name in requirements}
        reading = self._reading(trace, requirements[0] if len(requirements) == 1 else None, how)
        return {name: self._of_samples(reading, name, how) for name in requirements}

    def _of_own(self, own: Trace, requirement: str, how: _How) -> float:
        """Return ρ of one requirement at the begin of the trace that it reads, never 0."""
        if own.messages:
            return self._at_instants(own, requirement, how)
        rho = self._of_samples(self._reading(own, requirement, how), requirement, how)
        if own.origin is not None:
            self._refuse_other_verdict(own.origin, requirement, rho, how)
        return rho

    def _of_samples(self, reading: Reading, requirement: str, how: _How) -> float:
        """Return ρ of one requirement at the first sample, never 0."""
        formula = reading.bound(self.formulas[requirement])
        reading.refuse_short(formula)
        if not how.partial:
            self._check_length(requirement, formula, reading)
        bounds = None if how.partial else reading.bounds(formula)
        return decided_value(requirement, bounds or float(reading.signed(formula)[0]))

    def _at_instants(self, own: Trace, requirement: str, how: _How) -> float:
        """Return ρ of one requirement at the begin of a trace of messages that it reads, at every instant, never 0."""
        judge, formula = self._judge(own, requirement, how)
        judge.refuse_short(formula)
        judgement = judge.judge(formula, how.partial)
        if not (judgement.complete or how.partial):
            raise TraceError(
                f"{requirement!r} {judge.shortfall(formula)}; "
                f"give a longer trace, or set partial=True to cut windows at the end of this one"
            )
        if judgement.satisfied is None or (judgement.lower != judgement.upper and not judgement.several):
            why = judgement.open or "is not known exactly: a signal was silent, or began after the log"
            raise UndecidedError(f"{requirement!r} {why}")
        return judgement.signed

    def _refuse_other_verdict(self, messages: Trace, requirement: str, rho: float, how: _How) -> None:
        """Refuse ρ at the stamps of one topic where every instant decides otherwise.

        Raises:
            UndecidedError: they do.
        """
        own = messages.only(self.channels(requirement))
        if self.needs_samples(requirement, own):
            if self.contradicts(own, requirement, rho > 0, how.params, how.nan):
                raise UndecidedError(
                    f"{requirement!r} has ρ = {rho:.6g} at the samples; all messages contradict it"
                )
            return
        every = self._at_instants(own, requirement, replace(how, interpolation=None, partial=True))
        if (every > 0) != (rho > 0):
            raise UndecidedError(
                f"{requirement!r} has ρ = {rho:.6g} at the samples, and {every:.6g} at every instant"
            )

    def own_trace(self, trace: Trace, requirement: str) -> Trace:
        """Return the trace that a requirement reads: of messages, without the stamps of signals that it does not read.

        Raises:
            TraceError: a channel is missing.
        """
        trace = _as_trace(trace)
        if trace.messages:
            messages = trace.only(self.channels(requirement))
            own = messages.common()
            return own if own.messages or not sent_on_change(own.times) else replace(own, origin=messages)
        return trace if trace.origin is None else trace.only(self.channels(requirement)).known()

    def needs_samples(self, requirement: str, messages: Trace) -> bool:
        """Return whether some part of a requirement has no value between common samples of its messages."""
        times = {name: one.times for name, one in messages.messages.items()}
        return needs_samples(self.formulas[requirement], times)

    def contradicts(
        self,
        messages: Trace,
        requirement: str,
        satisfied: bool,
        params: Mapping[str, Amount] | None = None,
        nan: Missing = "error",
    ) -> bool:
        """Return whether all messages contradict a verdict at samples, whatever is known at samples alone."""
        judge, formula = self._judge(
            messages.only(self.channels(requirement)), requirement, _How(params, nan=nan)
        )
        return judge.contradicts(formula, satisfied)

    def _judge(self, trace: Trace, requirement: str, how: _How) -> tuple[Judge, f.Formula]:
        """Return the judge of a trace of messages, and the formula with numbers for time bounds."""
        if how.interpolation == "samples":
            raise UsageError(
                f"{requirement!r} reads signals with stamps of their own, which have no common samples: resample the "
                f"trace, or give --clock with a topic"
            )
        numbers = self._numbers(self._given(trace, how), requirement)
        signals = [self.signals[name] for name in self.channels(requirement)]
        linear = {signal.name for signal in signals if how.interpolation == "linear" and not signal.boolean}
        judge = Judge(
            read_streams(signals, trace, how.nan, linear), numbers, trace.since, trace.ends, how.until
        )
        return judge, bind(
            self._formula(requirement), {name: value.item() for name, value in numbers.items()}
        )

    def judge(
        self,
        trace: Trace,
        requirement: str,
        params: Mapping[str, Amount] | None = None,
        *,
        until: Witness = "open",
        nan: Missing = "error",
        partial: bool = False,
        sparse: bool = False,
    ) -> tuple[Judgement, Explanation | None]:
        """Return the verdict on a requirement, and its explanation, from signals with messages of their own.

        Every signal keeps its last value until its next message, and conditions are evaluated at every instant. The
        verdict is unknown where it depends on a signal that was silent; see :class:`Judgement`.

        For args and errors see :meth:`evaluate` and :meth:`explain`.
        """
        own = _as_trace(trace).only(self.channels(requirement))
        judge, formula = self._judge(own, requirement, _How(params, None, until, nan))
        if not sparse:
            judge.refuse_short(formula)
        judgement = judge.judge(formula, partial)
        if judgement.satisfied is None:
            return judgement, None
        return judgement, judge.explain(formula, judgement, requirement, self.unit(requirement))

    def robustness_signal(
        self,
        trace: Trace,
        requirement: str,
        params: Mapping[str, Amount] | None = None,
        *,
        interpolation: Interpolation | None = None,
        until: Witness = "open",
        end: End = "clip",
    ) -> FloatArray:
        """Return (n,): ρ of one requirement at every sample, as :meth:`evaluate` computes it."""
        evaluation = self.evaluate(
            trace, requirement, params, interpolation=interpolation, until=until, end=end
        )
        return evaluation.values

    def evaluate(
        self,
        trace: Trace,
        requirement: str,
        params: Mapping[str, Amount] | None = None,
        *,
        interpolation: Interpolation | None = None,
        until: Witness = "open",
        end: End = "clip",
        nan: Missing = "error",
        sparse: bool = False,
    ) -> Evaluation:
        """Return ρ of one requirement along a trace, and the samples at which the trace decides it.

        A failure of the trace does not change the result: the samples count here.

        Args:
            trace: see :meth:`robustness`.
            requirement: one of :attr:`requirements`.
            params: see :meth:`robustness`.
            interpolation: "samples" evaluates a condition only at the samples. "hold" and "linear" evaluate it at
                every instant from the first sample to the last; between samples, signals hold the last one or
                are linear. None is "samples" for common samples, and "hold" for signals with messages of their own.
            until: whether the left side of an until must hold before the witness only
                ("open", as in RTAMT's discrete time) or at the witness, too ("closed", as in Breach).
            end: treatment of the time after the last sample. "clip" cuts windows there; a window wholly past the
                end is empty, so ``always`` is +inf, and ``eventually`` and ``until`` are −inf. "hold" repeats the
                last sample of every signal. "nan" gives NaN where a window reaches past the end. "error" raises
                an error there.
            nan: the treatment of a NaN sample: "error", or "hold" to repeat the sample before.
            sparse: also evaluate windows shorter than the time between two samples, on the one sample in them.

        Raises:
            TraceError: see :meth:`robustness`.
            UsageError: see :meth:`robustness`.
        """
        _choice("end", end, ("clip", "hold", "nan", "error"))
        how = _How(params, interpolation, until, nan)
        trace = self.own_trace(trace, requirement)
        if trace.messages:
            judge, formula = self._judge(trace, requirement, how)
            if not sparse:
                judge.refuse_short(formula)
            return judge.evaluate(formula, requirement, self.unit(requirement), end)
        reading = self._reading(trace, requirement, how)
        formula = reading.bound(self._formula(requirement))
        if not sparse:
            reading.refuse_short(formula)
        return evaluate(formula, reading, requirement, self.unit(requirement), end)

    def bounds(
        self,
        trace: Trace,
        requirement: str,
        params: Mapping[str, Amount] | None = None,
        *,
        until: Witness = "open",
        nan: Missing = "error",
        sparse: bool = False,
    ) -> tuple[float, float] | None:
        """Return the bounds of ρ at a trace's first sample, if its common samples have a gap; else None.

        For args and errors see :meth:`evaluate`.
        """
        reading = self._reading(trace, requirement, _How(params, "samples", until, nan))
        formula = reading.bound(self._formula(requirement))
        if not sparse:
            reading.refuse_short(formula)
        return reading.bounds(formula)

    def robustness_tensor(
        self,
        signals: Mapping[str, Tensor],
        requirement: str,
        params: Mapping[str, Tensor] | None = None,
        *,
        period: float,
        until: Witness = "open",
        temperature: float = 0.0,
    ) -> Tensor:
        """Return (…, n): ρ of one requirement at every sample, for autograd.

        The same values as :meth:`robustness_signal` of regular samples, with windows cut at the end.

        Args:
            signals: channel → (…, n), or (…, width, n) of a vector, in the declared unit.
            requirement: one of :attr:`requirements`.
            params: name → a number, or (…) numbers, one for each batch entry.
            period: sample period [s].
            until: see :meth:`evaluate`.
            temperature: the temperature of a smooth minimum, in the unit of ρ; 0 for the exact one.
        """
        from s2r_spec.robustness.tensor import evaluate_tensors, read_numbers, read_tensors

        formula = self._formula(requirement)
        read = read_tensors([self.signals[name] for name in self.channels(requirement)], signals)
        numbers = read_numbers(formula, self.params, params or {}, like=next(iter(read.values())))
        return evaluate_tensors(formula, read, numbers, period, until, temperature)

    def monitor(
        self,
        params: Mapping[str, Amount] | None = None,
        requirement: str | None = None,
        *,
        period: float | None = None,
        until: Witness = "open",
        nan: Missing = "error",
        ranges: bool = True,
        sparse: bool = False,
    ) -> Monitor:
        """Return a monitor, which follows a trace sample by sample and bounds ρ at its first time.

        Conditions are evaluated at the samples. Work and memory do not grow with the trace.

        Args:
            params: see :meth:`robustness`.
            requirement: the one to follow; None for all.
            period: sample period [s], within 2 %: windows count samples, as in a recorded trace on a regular
                grid. Without it windows are measured in time, as in an irregular trace.
            until: see :meth:`evaluate`.
            nan: see :meth:`evaluate`.
            ranges: assume that signals stay in their declared ranges; a sample outside is then an error.
            sparse: see :meth:`evaluate`.

        Raises:
            UsageError: an operator over the whole rest of the trace is needed at more than the first instant, or a
                window is shorter than the period; also see :meth:`robustness`.
        """
        followed = self._follow(params, requirement, period, until, nan)
        return Monitor(replace(followed, ranges=ranges, sparse=sparse))

    def robustness_stream(
        self,
        params: Mapping[str, Amount] | None = None,
        requirement: str | None = None,
        *,
        period: float | None = None,
        until: Witness = "open",
        nan: Missing = "error",
        sparse: bool = False,
    ) -> RobustnessStream:
        """Return a stream, which computes ρ at every sample of a growing trace as soon as it is decided.

        Its values, in order, are :meth:`robustness_signal` of the whole trace. A sample takes constant time on
        average, for any length of windows.

        For args and errors see :meth:`monitor`. No operator may depend on the whole rest of the trace.
        """
        return RobustnessStream(replace(self._follow(params, requirement, period, until, nan), sparse=sparse))

    def explain(
        self,
        trace: Trace,
        requirement: str,
        params: Mapping[str, Amount] | None = None,
        *,
        until: Witness = "open",
        nan: Missing = "error",
        partial: bool = False,
        sparse: bool = False,
    ) -> Explanation:
        """Return the explanation of ρ of a requirement: the deciding instant, predicate, signal values and margin.

        ``print`` shows it in words. Conditions are evaluated at the samples.

        Args:
            trace: see :meth:`robustness`.
            requirement: one of :attr:`requirements`.
            params: see :meth:`robustness`.
            until: see :meth:`evaluate`.
            nan: see :meth:`evaluate`.
            partial: see :meth:`robustness`.
            sparse: see :meth:`evaluate`.

        Raises:
            TraceError: see :meth:`robustness`.
            UsageError: see :meth:`robustness`.
        """
        unit = self.unit(requirement)
        trace = _as_trace(trace)
        if trace.failure is not None:
            reason = f"the trace ended with {trace.failure!r}, for which the certify line declares this ρ"
            rho = self._fallen(requirement, trace.failure)
            return Explanation(requirement, rho, unit, satisfied=rho > 0, reason=reason)
        trace = self.own_trace(trace, requirement)
        if trace.messages:
            judged, why = self.judge(
                trace, requirement, params, until=until, nan=nan, partial=partial, sparse=sparse
            )
            if why is None:
                raise UndecidedError(f"{requirement!r} {judged.open or 'looks past the end of the trace'}")
            return why
        reading = self._reading(trace, requirement, _How(params, "samples", until, nan))
        formula = reading.bound(self._formula(requirement))
        if not sparse:
            reading.refuse_short(formula)
        if not partial:
            self._check_length(requirement, formula, reading)
        return explain(formula, reading, requirement, unit)

    def plot(
        self,
        trace: Trace,
        requirement: str,
        params: Mapping[str, Amount] | None = None,
        *,
        title: str = "",
    ) -> Plot:
        """Return a plot of the signals that a requirement reads, and of the values that it allows.

        The :class:`~s2r_spec.spec.plot.Plot` is shown by a notebook, and its ``save`` writes a file. A line marks the
        instant that decides ρ. Needs the extra ``pictures``.

        Args:
            trace: see :meth:`robustness`.
            requirement: one of :attr:`requirements`.
            params: see :meth:`robustness`.
            title: a line above the plot.

        Raises:
            TraceError: see :meth:`robustness`.
            UsageError: see :meth:`robustness`; or matplotlib is not installed.
        """
        reason = self.explain(trace, requirement, params, partial=True)
        return draw(self.tolerances(trace, requirement, params), reason, title)

    def tolerances(
        self, trace: Trace, requirement: str, params: Mapping[str, Amount] | None = None
    ) -> Tolerances:
        """Return the signals that a requirement reads, with their allowed values over time.

        A failure of the trace does not change the result.

        Raises:
            TraceError: see :meth:`robustness`.
            UsageError: see :meth:`robustness`.
        """
        formula = self._formula(requirement)
        trace = self.own_trace(trace, requirement)
        if trace.messages:
            known = max(float(one.times[0]) for one in trace.messages.values())
            trace = trace.sampled_at(trace.times[trace.times >= known])
        return tolerances(formula, self._reading(trace, requirement, _How(params, nan="hold")))

    def _reading(self, trace: Trace, requirement: str | None, how: _How) -> Reading:
        trace = _as_trace(trace)
        numbers = self._numbers(self._given(trace, how), requirement)
        signals = read_signals([self.signals[name] for name in self.channels(requirement)], trace, how.nan)
        return Reading.of(trace.times, signals, numbers, how.interpolation or "samples", how.until)

    def _given(self, trace: Trace, how: _How) -> Mapping[str, Amount]:
        """Return parameter → value: as given, or else as the trace was recorded with."""
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
    ) -> Followed:
        _choice("until", until, ("open", "closed"))
        _choice("nan", nan, ("error", "hold"))
        numbers = {name: value.item() for name, value in self._numbers(params, requirement).items()}
        requirements = self.requirements if requirement is None else (requirement,)
        formulas = {name: bind(self._formula(name), numbers) for name in requirements}
        signals = [self.signals[name] for name in self.channels(requirement)]
        return Followed(formulas, signals, numbers, period, until, nan, ranges=False)

    def _check_length(self, requirement: str, formula: f.Formula, reading: Reading) -> None:
        if reading.complete(formula)[0]:
            return
        raise TraceError(
            f"{requirement!r} {shortfall(formula, reading)}; "
            f"give a longer trace, or set partial=True to cut windows at the end of this one"
        )

    def shortfall(
        self,
        trace: Trace,
        requirement: str,
        params: Mapping[str, Amount] | None = None,
        nan: Missing = "error",
    ) -> str:
        """Return in words how far the horizon of a requirement is past the end of a trace.

        For args and errors see :meth:`evaluate`.
        """
        trace = self.own_trace(trace, requirement)
        if trace.messages:
            judge, formula = self._judge(trace, requirement, _How(params, nan=nan))
            return judge.shortfall(formula)
        reading = self._reading(trace, requirement, _How(params, nan=nan))
        return shortfall(reading.bound(self._formula(requirement)), reading)

    def _fallen(self, requirement: str, failure: str) -> float:
        settings = self.certify.get(requirement)
        if settings is None or settings.fall is None:
            raise UsageError(
                f"the trace ended with {failure!r}, but {self.name} declares no ρ for a failure; "
                f"add a line such as `certify {requirement}: fall = -1`"
            )
        return settings.fall


def decided_value(requirement: str, rho: float | tuple[float, float]) -> float:
    """Return ρ, or ρ within bounds that are equal.

    Raises:
        UndecidedError: the bounds differ.
    """
    if isinstance(rho, float):
        return rho
    if rho[0] != rho[1]:
        raise UndecidedError(
            f"{requirement!r} depends on a gap without samples; ρ lies in [{rho[0]:.6g}, {rho[1]:.6g}]"
        )
    return rho[0]


def _declaration_text(one: Signal | Param) -> str:
    """Return a declaration as ``vd [m/s]``."""
    return f"{one.name} [{one.unit}]" if one.unit else one.name


def _as_trace(trace: Any) -> Trace:
    """Return a trace, also of a data frame.

    Raises:
        TraceError: it is another value.
    """
    if isinstance(trace, Trace):
        return trace
    if hasattr(trace, "columns"):
        return Trace.from_dataframe(trace)
    remedy = "s2r.Trace makes one"
    if isinstance(trace, str | PathLike):
        remedy = "s2r.read_trace(path) reads one"
    raise TraceError(f"a trace is needed, not a value of type {type(trace).__name__}; {remedy}")


def _choice(name: str, value: str, choices: tuple[str, ...]) -> None:
    if value not in choices:
        raise UsageError(f"{name}={value!r} is not one of {', '.join(map(repr, choices))}")
