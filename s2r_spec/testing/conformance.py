"""Check that a backend conforms to its protocol: channels, seeds, ranges, effects. For authors of backends.

Every check runs rollouts of the backend's default test, or at the ends of its declared ranges.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from s2r_spec.backend import (
    Backend,
    Effect,
    EffectParameter,
    HasChosen,
    HasEffects,
    HasRecordings,
    HasResiduals,
    HasVariants,
    NeedsSpec,
    is_exclusive,
)
from s2r_spec.backend.effects import catalogue_of
from s2r_spec.backend.protocols import PROTOCOL, HasPlayable, HasProtocols, Protocol
from s2r_spec.base.errors import UsageError
from s2r_spec.base.json_values import Shown
from s2r_spec.runs.passed import PassedBackend
from s2r_spec.runs.repeatability import check_here, difference
from s2r_spec.runs.scorer import open_for_requirement
from s2r_spec.spec import Spec
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]
Values = dict[str, dict[str, float]]

SEED = 1
HALF = 0.5
"""Definition: size of a tested effect, as a share of the distance from nominal to the farther end of its range."""
TINY = 1e-6
"""Definition: size of a tiny effect, as the same share."""
SEED_SHARE = 0.5
"""Tolerance: change of a channel by a tiny effect, as a share of its change by another seed."""
EXPLAINED = 0.5
"""Tolerance: residual with the effect in the model, as a share of the residual without it."""
SLACK = 1.5
"""Tolerance: difference between a rollout's duration and the declared one, in samples."""


@dataclass
class Check(Shown):
    """The result of one requirement on a backend.

    Attributes:
        requirement: the requirement on the backend, as a sentence.
        words: the requirement.
        violations: one sentence per violation.
        broken: one sentence for each violation of the requirement.
        remarks: one sentence for each fact that is allowed, but may not be intended.
    """

    requirement: str
    violations: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)

    JSON = "words=requirement broken=violations remarks"


def check_conformance(
    backend: Backend, spec: Spec | None = None, requirement: str | None = None
) -> Iterator[Check]:
    """Check a backend against every requirement, one after the other; an exception of the backend is a violation.

    Args:
        backend: the backend.
        spec: declares channels, parameters and duration of a backend that has none of its own, such as a
            :class:`~s2r_spec.backend.function.FunctionBackend`. Other backends do not need it.
        requirement: the name of the requirement; the spec's first one if None.

    Raises:
        UsageError: the backend is a machine, which the checks would move.
    """
    if is_exclusive(backend):
        raise UsageError(
            f"{backend.name} is a machine, and the checks would move it to the ends of its ranges; check its twin"
        )
    if spec is not None and isinstance(backend, NeedsSpec):
        backend = open_for_requirement(spec, requirement or spec.requirements[0], backend)
    subject = _Subject(backend)
    checks: list[tuple[str, Callable[[_Subject, Check], None]]] = [
        ("its default test runs", _runs),
        ("its traces have the declared channels and the declared duration", _check_declared),
        ("test and seed determine a trace, bit for bit, whatever ran before it", _check_repeated),
        ("every test parameter runs at both ends of its range", _ends),
    ]
    if isinstance(backend, HasEffects):
        checks += [
            ("every effect has parameters, with valid ranges and priors", _catalogue),
            ("an effect at its nominal values changes no bit", _nominal),
            ("every effect runs at both ends of its range, and changes the trace", _ranges),
            ("effects can be added together, in any order", _order),
            ("its random numbers do not depend on effects", _draws),
            ("an added effect changes the model hash, and is reported", _identity),
        ]
    if isinstance(backend, HasEffects) and isinstance(backend, HasResiduals):
        checks.append(("its residuals can be computed for its own rollouts, with any effect", _residuals))
    if isinstance(backend, HasProtocols):
        checks += [
            ("every protocol has a name of its own, a duration, and valid parameters", _protocols),
            ("every protocol runs, and its trace has its name and its duration", _protocol_runs),
            ("every parameter of a protocol runs at both ends of its range, and no further", _protocol_ends),
            ("a protocol that it does not offer is refused", _protocol_unknown),
        ]
    if isinstance(backend, HasProtocols) and isinstance(backend, HasPlayable):
        checks.append(("the references of every protocol can be played", _protocol_playable))
    if isinstance(backend, HasVariants):
        checks.append(("its variants simulate the same system in another way", _variants))
    for requirement, run in checks:
        check = Check(requirement)
        try:
            run(subject, check)
        except Exception as error:  # third-party code may raise anything
            check.violations.append(_describe(error))
        yield check
        if check.violations and run in (_runs, _catalogue, _protocols):
            return  # all others depend on it


class _Subject:
    """A backend under check, its default test and that test's rollouts."""

    def __init__(self, backend: Backend) -> None:
        self.backend = backend

    @cached_property
    def test(self) -> dict[str, float]:
        return {p.name: p.default for p in self.backend.parameters}

    @cached_property
    def first(self) -> Trace:
        return _rollout(self.backend, self.test)

    @cached_property
    def effects(self) -> tuple[Effect, ...]:
        """The catalogue; an effect that the backend reports as added has its added value as nominal."""
        return catalogue_of(self.backend)

    @cached_property
    def half_effects(self) -> dict[str, Values]:
        """Every effect at half size, set by its first parameter that changes the trace on its own."""
        return {effect.name: self._half(effect) for effect in self.effects}

    def _half(self, effect: Effect) -> Values:
        candidates = [{effect.name: {p.name: _towards(p, HALF)}} for p in effect.parameters]
        if self.backend.deterministic:
            for values in candidates:
                if not _is_same(self.first, _rollout(self.with_effects(values), self.test)):
                    return values
        return candidates[0]

    def with_effects(self, values: Mapping[str, Mapping[str, float]], base: object = None) -> Backend:
        """Return the backend, or ``base``, with these effects.

        Raises:
            TypeError: the result is not a backend.
        """
        simulator = self.backend if base is None else base
        assert isinstance(simulator, HasEffects)
        changed = simulator.with_effects(values)
        if not isinstance(changed, Backend):
            raise TypeError(
                f"with_effects({dict(values)}) returns {type(changed).__name__}, which is not a backend"
            )
        return changed


def _rollout(backend: Backend, test: Mapping[str, float]) -> Trace:
    trace: object = backend.rollout(test, SEED)
    if not isinstance(trace, Trace):
        raise TypeError(f"rollout returns {type(trace).__name__}, which is not a Trace")
    return trace


def _describe(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"


def _is_same(one: Trace, other: Trace) -> bool:
    """Return whether two traces are the same, bit for bit."""
    return one.channels.keys() == other.channels.keys() and difference(one, other) is None


def _towards(parameter: EffectParameter, share: float) -> float:
    """Return the value at this share of the distance from nominal to the farther end of the range."""
    low, high, nominal = parameter.low, parameter.high, parameter.nominal
    return nominal + share * ((high if high - nominal >= nominal - low else low) - nominal)


def _rms_difference(one: Trace, other: Trace) -> dict[str, float]:
    """Return channel → rms difference of two traces, over the length of the shorter one."""
    size = min(len(one), len(other))
    return {name: _rms(values[:size] - other[name][:size]) for name, values in one.channels.items()}


def _runs(subject: _Subject, out: Check) -> None:
    names = Counter(p.name for p in subject.backend.parameters)
    out.violations += [
        f"the parameter {name} is declared {count} times" for name, count in names.items() if count > 1
    ]
    for p in subject.backend.parameters:
        if not (p.low <= p.default <= p.high and math.isfinite(p.high - p.low)):
            out.violations.append(
                f"{p.name} has the default {p.default:g} in [{p.low:g}, {p.high:g}] {p.unit}".rstrip()
            )
    if isinstance(subject.backend, NeedsSpec) and not subject.backend.parameters:
        out.remarks.append(
            "it declares no parameters, so its function gets none; check_conformance(backend, spec) takes them from a "
            "spec"
        )
    if subject.first.failure is not None:
        out.remarks.append(f"it ends early: {subject.first.failure}")


def _check_declared(subject: _Subject, out: Check) -> None:
    trace, backend = subject.first, subject.backend
    for channel in backend.channels:
        if channel.name not in trace.channels:
            out.violations.append(f"the declared channel {channel.name} is missing in the trace")
            continue
        width = trace[channel.name].reshape(len(trace), -1).shape[1]
        if width != channel.width:
            out.violations.append(
                f"{channel.name} has {width} columns in the trace, but {channel.width} in its declaration"
            )
        unit = trace.units.get(channel.name, channel.unit)
        if unit != channel.unit:
            out.violations.append(
                f"{channel.name} is in {unit or '1'} in the trace, but in {channel.unit or '1'} in its declaration"
            )
        if not np.isfinite(trace[channel.name]).all():
            out.remarks.append(f"{channel.name} has samples that are not finite")
    step = float(np.diff(trace.times).max()) if len(trace) > 1 else 0.0
    if (
        trace.failure is None
        and not isinstance(backend, HasRecordings)
        and not (isinstance(backend, NeedsSpec) and backend.duration == 0)  # a spec's horizon replaces it
        and abs(trace.duration - backend.duration) > SLACK * step
    ):
        out.violations.append(
            f"a rollout lasts {trace.duration:g} s, but the declared duration is {backend.duration:g} s"
        )


def _check_repeated(subject: _Subject, out: Check) -> None:
    backend, test = subject.backend, subject.test
    if not backend.deterministic:
        out.remarks.append(
            "it is declared as not deterministic: no rollout can be replayed, and small effects go unnoticed"
        )
        return
    if not _is_same(subject.first, _rollout(backend, test)):
        out.violations.append("two rollouts with one seed differ; draw all random numbers from the seed")
    if isinstance(backend, HasRecordings):
        return
    ends = [{**test, p.name: value} for p in backend.parameters for value in (p.low, p.high)]
    # The default test has run first in this process, so another one shows state of the first. An end that cannot run is
    # reported by another check.
    other = next((end for end in ends if end != test and _try(Check(""), "", backend, end) is not None), test)
    if violation := check_here(backend, other, test, SEED):
        out.violations.append(violation)
    if not PassedBackend(backend).portable:
        out.remarks.append("no other process can load it, so its rollouts were repeated in this one alone")


def _ends(subject: _Subject, out: Check) -> None:
    if isinstance(subject.backend, HasRecordings):
        out.remarks.append("it has only the recorded tests")
        return
    for p in subject.backend.parameters:
        for value in dict.fromkeys((p.low, p.high)):
            _try(
                out,
                f"{p.name} = {value:g} {p.unit}".rstrip(),
                subject.backend,
                {**subject.test, p.name: value},
            )


def _try(out: Check, at: str, backend: Backend, test: Mapping[str, float]) -> Trace | None:
    """Run a test; an exception is a violation, and an early end a remark."""
    try:
        trace = _rollout(backend, test)
    except Exception as error:
        out.violations.append(
            f"{at}: {_describe(error)}; a rollout that cannot go on must end with meta['failure']"
        )
        return None
    if trace.failure is not None:
        out.remarks.append(f"{at}: ends early ({trace.failure})")
    return trace


def _catalogue(subject: _Subject, out: Check) -> None:
    names = Counter(effect.name for effect in subject.effects)
    out.violations += [
        f"the effect {name} is declared {count} times" for name, count in names.items() if count > 1
    ]
    out.violations += [
        f"{effect.name} has no parameters" for effect in subject.effects if not effect.parameters
    ]


def _nominal(subject: _Subject, out: Check) -> None:
    if not subject.backend.deterministic:
        out.remarks.append("not checked: the backend is not deterministic")
        return
    for effect in subject.effects:
        values = {effect.name: {p.name: p.nominal for p in effect.parameters}}
        if not _is_same(subject.first, _rollout(subject.with_effects(values), subject.test)):
            out.violations.append(f"{effect.name} changes the trace at its nominal values")


def _ranges(subject: _Subject, out: Check) -> None:
    for effect in subject.effects:
        changed = False
        for p in effect.parameters:
            for value in dict.fromkeys((p.low, p.high)):
                # A parameter of an effect's shape matters only if the effect has some size.
                values = {effect.name: {**subject.half_effects[effect.name][effect.name], p.name: value}}
                words = ", ".join(f"{name}={x:g}" for name, x in values[effect.name].items())
                trace = _try(out, f"{effect.name} with {words}", subject.with_effects(values), subject.test)
                changed = changed or trace is None or not _is_same(subject.first, trace)
        if not changed:
            out.violations.append(
                f"{effect.name} changes nothing in the default test, at either end of its range"
            )


def _order(subject: _Subject, out: Check) -> None:
    for one, other in pairwise(subject.half_effects):
        backends = [
            subject.with_effects(
                subject.half_effects[last], subject.with_effects(subject.half_effects[first])
            )
            for first, last in ((one, other), (other, one))
        ]
        traces = [_try(out, f"{one} and {other}", backend, subject.test) for backend in backends]
        if subject.backend.deterministic and None not in traces and not _is_same(*traces):  # type: ignore[arg-type]
            out.violations.append(f"the order matters: {one} and {other} differ from {other} and {one}")
    everything = {name: values for one in subject.half_effects.values() for name, values in one.items()}
    _try(out, "all effects together", subject.with_effects(everything), subject.test)


def _draws(subject: _Subject, out: Check) -> None:
    if not subject.backend.deterministic:
        out.remarks.append("not checked: the backend is not deterministic")
        return
    seeds = _rms_difference(subject.first, subject.backend.rollout(subject.test, SEED + 1))
    noisy = [name for name, change in seeds.items() if change > 0.0]
    for effect in subject.effects if noisy else ():
        values = {effect.name: {p.name: _towards(p, TINY) for p in effect.parameters}}
        trace = _try(out, f"a tiny {effect.name}", subject.with_effects(values), subject.test)
        if trace is not None and trace.channels.keys() == subject.first.channels.keys():
            change = _rms_difference(subject.first, trace)
            if np.median([change[name] / seeds[name] for name in noisy]) > SEED_SHARE:
                out.violations.append(
                    f"a tiny {effect.name} changes the trace as much as another seed does; draw all random numbers "
                    f"before any code that depends on an effect"
                )


def _variants(subject: _Subject, out: Check) -> None:
    assert isinstance(subject.backend, HasVariants)
    for name, variant in subject.backend.variants().items():
        trace = _try(out, f"the variant {name!r}", variant, subject.test)
        if trace is None:
            continue
        if trace.channels.keys() != subject.first.channels.keys():
            out.violations.append(f"the variant {name!r} has other channels")
        elif subject.backend.deterministic and _is_same(subject.first, trace):
            out.violations.append(f"the variant {name!r} gives the simulator's own trace")
        if variant.model_hash == subject.backend.model_hash:
            out.violations.append(
                f"the variant {name!r} has the simulator's model hash, so its rollouts would be confused with the "
                f"simulator's"
            )


def _protocols(subject: _Subject, out: Check) -> None:
    assert isinstance(subject.backend, HasProtocols)
    offered = subject.backend.protocols()
    names = Counter(protocol.name for protocol in offered)
    out.violations += [
        f"the protocol {name} is declared {count} times" for name, count in names.items() if count > 1
    ]
    for protocol in offered:
        if not (protocol.duration > 0.0 and protocol.cost > 0.0):
            out.violations.append(
                f"{protocol.name} has the duration {protocol.duration:g} s and the cost {protocol.cost:g} s; "
                f"both must be positive"
            )
        if not protocol.words:
            out.violations.append(f"{protocol.name} does not say in words what a person does")
        out.violations += [
            f"{protocol.name}: {p.name} has the default {p.default:g} in [{p.low:g}, {p.high:g}] {p.unit}".rstrip()
            for p in protocol.parameters
            if not (p.low <= p.default <= p.high and math.isfinite(p.high - p.low))
        ]


def _protocol_runs(subject: _Subject, out: Check) -> None:
    assert isinstance(subject.backend, HasProtocols)
    for protocol in subject.backend.protocols():
        trace = _try_protocol(subject, out, protocol, {})
        if trace is None:
            continue
        step = float(np.diff(trace.times).max()) if len(trace) > 1 else 0.0
        if trace.failure is None and abs(trace.duration - protocol.duration) > SLACK * step:
            out.violations.append(
                f"{protocol.name} lasts {trace.duration:g} s, but its declared duration is {protocol.duration:g} s"
            )
        again = _try_protocol(subject, out, protocol, {}) if subject.backend.deterministic else None
        if again is not None and not _is_same(trace, again):
            out.violations.append(f"two runs of {protocol.name} with one seed differ")


def _protocol_ends(subject: _Subject, out: Check) -> None:
    assert isinstance(subject.backend, HasProtocols)
    for protocol in subject.backend.protocols():
        for p in protocol.parameters:
            for value in dict.fromkeys((p.low, p.high)):
                _try_protocol(subject, out, protocol, {p.name: value})
        beyond = {p.name: p.high + 1.0 for p in protocol.parameters[:1]}
        for wrong in (beyond, {"no such parameter": 0.0}):
            if wrong and not _refuses(subject.backend, protocol.name, wrong):
                out.violations.append(f"{protocol.name} runs with {wrong} instead of raising a UsageError")


def _protocol_unknown(subject: _Subject, out: Check) -> None:
    assert isinstance(subject.backend, HasProtocols)
    if not _refuses(subject.backend, "no such protocol", {}):
        out.violations.append("a protocol with an unknown name runs instead of raising a UsageError")


def _protocol_playable(subject: _Subject, out: Check) -> None:
    assert isinstance(subject.backend, HasProtocols)
    assert isinstance(subject.backend, HasPlayable)
    for protocol in subject.backend.protocols():
        played = subject.backend.playable(protocol.name, {})
        shapes = {name: values.shape for name, values in played.channels.items()}
        missing = [name for name in ("q", "dq", "kp", "kd") if name not in shapes]
        if missing:
            out.violations.append(f"the references of {protocol.name} lack the channels {', '.join(missing)}")
        elif shapes["q"] != shapes["dq"] or not all(np.isfinite(x).all() for x in played.channels.values()):
            out.violations.append(f"the references of {protocol.name} differ in shape, or are not finite")


def _try_protocol(
    subject: _Subject, out: Check, protocol: Protocol, params: Mapping[str, float]
) -> Trace | None:
    """Run a protocol; an exception or a missing name is a violation, and an early end a remark."""
    assert isinstance(subject.backend, HasProtocols)
    at = f"{protocol.name} with {dict(params)}" if params else protocol.name
    try:
        trace: object = subject.backend.run(protocol.name, params, SEED)
    except Exception as error:
        out.violations.append(
            f"{at}: {_describe(error)}; a run that cannot go on must end with meta['failure']"
        )
        return None
    if not isinstance(trace, Trace):
        out.violations.append(f"{at}: run returns {type(trace).__name__}, which is not a Trace")
        return None
    if trace.meta.get(PROTOCOL) != protocol.name:
        out.violations.append(
            f"{at}: meta[{PROTOCOL!r}] is {trace.meta.get(PROTOCOL)!r}, not the protocol's name"
        )
    if trace.failure is not None:
        out.remarks.append(f"{at}: ends early ({trace.failure})")
    return trace


def _refuses(backend: HasProtocols, name: str, params: Mapping[str, float]) -> bool:
    """Return whether a run raises a UsageError."""
    try:
        backend.run(name, params, SEED)
    except UsageError:
        return True
    return False


def _identity(subject: _Subject, out: Check) -> None:
    if not isinstance(subject.backend, HasChosen):
        out.remarks.append("it has no chosen(), so a diagnosis does not know its added effects")
    for name, values in subject.half_effects.items():
        changed = subject.with_effects(values)
        less = {name: {p: HALF * (x + _nominal_of(subject, name, p)) for p, x in values[name].items()}}
        hashes = {subject.backend.model_hash, changed.model_hash, subject.with_effects(less).model_hash}
        if len(hashes) < 3:
            out.violations.append(
                f"the model hash does not depend on {name}, so rollouts with it would be confused with others"
            )
        if isinstance(changed, HasChosen):
            reported, added = dict(changed.chosen().get(name, {})), values[name]
            if any(p not in reported or not np.isclose(reported[p], x) for p, x in added.items()):
                out.violations.append(f"chosen() reports {reported} for {name}, but {added} was added")


def _nominal_of(subject: _Subject, effect: str, parameter: str) -> float:
    return next(
        p.nominal for e in subject.effects if e.name == effect for p in e.parameters if p.name == parameter
    )


def _residuals(subject: _Subject, out: Check) -> None:
    insensitive, weak = [], []
    for name, values in subject.half_effects.items():
        changed = subject.with_effects(values)
        trace = _rollout(changed, subject.test)
        nominal, modelled = (
            _residuals_of(backend, trace, subject.test) for backend in (subject.backend, changed)
        )
        if {n: x.shape for n, x in nominal.items()} != {n: x.shape for n, x in modelled.items()}:
            out.violations.append(f"{name} changes the channels or the times of the residuals")
            continue
        shares = [
            _rms(modelled[n]) / max(_rms(x), 1e-300)
            for n, x in nominal.items()
            if not np.array_equal(x, modelled[n], equal_nan=True)
        ]
        if not shares:
            insensitive.append(name)
        elif min(shares) > EXPLAINED:
            weak.append(f"{name} ({100 * min(shares):.0f} %)")
    if insensitive:
        out.remarks.append(
            f"in the default test they do not depend on {', '.join(insensitive)}: a diagnosis cannot estimate these "
            f"effects from the equations of motion"
        )
    if weak:
        out.remarks.append(
            f"more than half of the residual remains with the effect in the model: {', '.join(weak)}; "
            f"in the default test the equations say little about them"
        )


def _residuals_of(backend: Backend, trace: Trace, test: Mapping[str, float]) -> dict[str, FloatArray]:
    assert isinstance(backend, HasResiduals)
    return {name: np.asarray(values) for name, values in backend.residuals(trace, test).channels.items()}


def _rms(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else 0.0
