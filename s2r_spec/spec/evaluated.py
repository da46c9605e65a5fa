"""Evaluation of a specification on traces: ρ, recorded or online, and its explanation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.errors import UndecidedError
from s2r_spec.lang import formula as f
from s2r_spec.lang.amounts import Amount
from s2r_spec.robustness.evaluate import Witness
from s2r_spec.robustness.evaluation import End, Evaluation, Interpolation, Reading
from s2r_spec.robustness.explain import Explanation, explain
from s2r_spec.robustness.reading import Missing
from s2r_spec.robustness.ties import restore_zero
from s2r_spec.spec.on_traces import How, OnTraces, as_trace, refuse_short_trace
from s2r_spec.trace import Trace

if TYPE_CHECKING:
    from torch import Tensor

    from s2r_spec.robustness.judge import Judge, Judgement
    from s2r_spec.robustness.online.monitor import Monitor, RobustnessStream
    from s2r_spec.robustness.tolerances import Tolerances
    from s2r_spec.spec.plot import Plot


class Spec(OnTraces):
    """A checked specification. Made by :func:`parse_spec` and :func:`load_spec`; can be pickled."""

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
        trace = as_trace(trace)
        if trace.failure is not None:
            return {name: self._fallen(name, trace.failure) for name in names}
        if end is not None:
            how = How(params, interpolation, until, nan, end=end)
            return {name: self._evaluate(trace, name, how).value for name in names}
        signed = self._at_start(trace, names, How(params, interpolation, until, nan, partial))
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
        trace = as_trace(trace)
        if trace.failure is not None:
            return {name: self._fallen(name, trace.failure) > 0 for name in names}
        signed = self._at_start(trace, names, How(params, interpolation, until, nan, partial))
        return {name: rho > 0 for name, rho in signed.items()}

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
        own = as_trace(trace).only(self.channels(requirement))
        judge, formula = self._judge(own, requirement, How(params, None, until, nan))
        if not sparse:
            judge.refuse_short(formula)
        return self._explain_judgement(judge, formula, requirement, partial)

    def _explain_judgement(
        self, judge: Judge, formula: f.Formula, requirement: str, partial: bool
    ) -> tuple[Judgement, Explanation | None]:
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
        how = How(params, interpolation, until, end=end)
        return self._evaluate(trace, requirement, how).values

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

        For errors see :meth:`robustness`.
        """
        how = How(params, interpolation, until, nan, sparse=sparse, end=end)
        return self._evaluate(trace, requirement, how)

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
        reading = self._reading(trace, requirement, How(params, "samples", until, nan))
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
        from s2r_spec.robustness.online.monitor import Monitor

        return Monitor(self._follow(params, requirement, period, until, nan, sparse, ranges))

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
        from s2r_spec.robustness.online.monitor import RobustnessStream

        followed = self._follow(params, requirement, period, until, nan, sparse, ranges=False)
        return RobustnessStream(followed)

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

        For args and errors see :meth:`evaluate`, and :meth:`robustness` for ``partial``.
        """
        unit = self.unit(requirement)
        trace = as_trace(trace)
        if trace.failure is not None:
            reason = f"the trace ended with {trace.failure!r}, for which the certify line declares this ρ"
            rho = self._fallen(requirement, trace.failure)
            return Explanation(requirement, rho, unit, satisfied=rho > 0, reason=reason)
        how = How(params, None, until, nan, sparse=sparse)
        reader, formula = self._read(self.own_trace(trace, requirement), requirement, how)
        if not isinstance(reader, Reading):
            judged, why = self._explain_judgement(reader, formula, requirement, partial)
            if why is None:
                raise UndecidedError(f"{requirement!r} {judged.open or 'looks past the end of the trace'}")
            return why
        if not partial:
            refuse_short_trace(reader, formula, requirement)
        return explain(formula, reader, requirement, unit)

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
            UsageError: matplotlib is not installed; or see :meth:`robustness`, also for other errors.
        """
        from s2r_spec.spec.plot import draw

        reason = self.explain(trace, requirement, params, partial=True)
        return draw(self.tolerances(trace, requirement, params), reason, title)

    def tolerances(
        self, trace: Trace, requirement: str, params: Mapping[str, Amount] | None = None
    ) -> Tolerances:
        """Return the signals that a requirement reads, with their allowed values over time.

        A failure of the trace does not change the result. For errors see :meth:`robustness`.
        """
        from s2r_spec.robustness.tolerances import tolerances

        formula = self._formula(requirement)
        trace = self.own_trace(trace, requirement)
        if trace.messages:
            known = max(float(one.times[0]) for one in trace.messages.values())
            trace = trace.sampled_at(trace.times[trace.times >= known])
        return tolerances(formula, self._reading(trace, requirement, How(params, nan="hold")))

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
        how = How(params, nan=nan, sparse=True)
        reader, formula = self._read(self.own_trace(trace, requirement), requirement, how)
        return reader.shortfall(formula)
