"""Conformance of a backend with its protocol: channels, seeds, ranges, effects. For authors of backends.

Every requirement is tried by rollouts of the backend's default test, and at the ends of its declared ranges.
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
    is_exclusive,
)
from s2r_spec.effects import catalogue_of
from s2r_spec.errors import UsageError
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]
Values = dict[str, dict[str, float]]

SEED = 1
HALF = 0.5
"""Where effects are tried: this part of the way from nominal to the farther end of the range."""
VERY_LITTLE = 1e-6
"""The same part, of next to nothing."""
OTHERWISE = 0.5
"""Of what another seed changes: next to nothing of an effect changes less of most channels."""
KNOWN = 0.5
"""A residual that knows an effect well leaves less than this part of what the nominal model leaves of it."""
SLACK = 1.5
"""In samples: by how much a rollout may be shorter or longer than the backend says."""


@dataclass
class Check:
    """The result of trying one requirement.

    Attributes:
        requirement: that a backend should meet.
        violations: a sentence for each place where it is not met.
        remarks: sentences on what is allowed, but may not be intended.
    """

    requirement: str
    violations: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)


def check_conformance(backend: Backend) -> Iterator[Check]:
    """Try every requirement on a backend, one after the other; an exception that it raises is a violation.

    Raises:
        UsageError: it is a machine, which this would move.
    """
    if is_exclusive(backend):
        raise UsageError(
            f"{backend.name} is a machine: trying its promises would move it to the ends of its ranges"
        )
    trial = _Trial(backend)
    attempts: list[tuple[str, Callable[[_Trial, Check], None]]] = [
        ("its default test runs", _runs),
        ("its traces have the channels that it declares, and last as long as it says", _declared),
        ("test and seed fix a trace, bit for bit", _repeated),
        ("every test parameter can be what its range says", _ends),
    ]
    if isinstance(backend, HasEffects):
        attempts += [
            ("every effect has parameters, with ranges and priors that can be read", _catalogue),
            ("an effect at its nominal values changes no bit", _nominal),
            ("every effect can be what its range says, and does something there", _ranges),
            ("effects can be added together, in any order", _order),
            ("its random numbers do not depend on effects", _draws),
            ("a machine with an effect has another hash, and says what it was given", _identity),
        ]
    if isinstance(backend, HasEffects) and isinstance(backend, HasResiduals):
        attempts.append(
            ("its residuals can be computed of its own rollouts, whatever effects are added", _residuals)
        )
    if isinstance(backend, HasVariants):
        attempts.append(("its variants are the same machine, computed otherwise", _variants))
    for requirement, attempt in attempts:
        check = Check(requirement)
        try:
            attempt(trial, check)
        except Exception as error:  # third-party code may raise anything
            check.violations.append(_described(error))
        yield check
        if check.violations and attempt in (_runs, _catalogue):
            return  # all others depend on it


class _Trial:
    """A backend, its default test, and what comes of it."""

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
        """The catalogue; nominal is what the backend was given, if it says so."""
        return catalogue_of(self.backend)

    @cached_property
    def there(self) -> dict[str, Values]:
        """Every effect, half there by the first of its parameters that alone changes the trace."""
        return {effect.name: self._there(effect) for effect in self.effects}

    def _there(self, effect: Effect) -> Values:
        tried = [{effect.name: {p.name: _towards(p, HALF)}} for p in effect.parameters]
        if self.backend.deterministic:
            for values in tried:
                if not _same(self.first, _rollout(self.added(values), self.test)):
                    return values
        return tried[0]

    def added(self, values: Mapping[str, Mapping[str, float]], to: object = None) -> Backend:
        """Return the backend with these effects, or say that it is none."""
        before = self.backend if to is None else to
        assert isinstance(before, HasEffects)
        machine = before.with_effects(values)
        if not isinstance(machine, Backend):
            raise TypeError(
                f"with_effects({dict(values)}) returns {type(machine).__name__}, which is no backend"
            )
        return machine


def _rollout(machine: Backend, test: Mapping[str, float]) -> Trace:
    trace: object = machine.rollout(test, SEED)
    if not isinstance(trace, Trace):
        raise TypeError(f"rollout returns {type(trace).__name__}, which is no Trace")
    return trace


def _described(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"


def _same(one: Trace, other: Trace) -> bool:
    """Return whether two traces are the same, bit for bit."""
    return (
        one.channels.keys() == other.channels.keys()
        and np.array_equal(one.times, other.times)
        and all(np.array_equal(values, other[name], equal_nan=True) for name, values in one.channels.items())
    )


def _towards(parameter: EffectParameter, part: float) -> float:
    """Return the value at this part of the way from nominal to the farther end of the range."""
    low, high, nominal = parameter.low, parameter.high, parameter.nominal
    return nominal + part * ((high if high - nominal >= nominal - low else low) - nominal)


def _apart(one: Trace, other: Trace) -> dict[str, float]:
    """Return channel → rms difference of two traces, as far as both go."""
    size = min(len(one), len(other))
    return {name: _rms(values[:size] - other[name][:size]) for name, values in one.channels.items()}


def _runs(trial: _Trial, out: Check) -> None:
    names = Counter(p.name for p in trial.backend.parameters)
    out.violations += [
        f"the parameter {name} is declared {count} times" for name, count in names.items() if count > 1
    ]
    for p in trial.backend.parameters:
        if not (p.low <= p.default <= p.high and math.isfinite(p.high - p.low)):
            out.violations.append(
                f"{p.name} has the default {p.default:g} in [{p.low:g}, {p.high:g}] {p.unit}".rstrip()
            )
    if trial.first.failure is not None:
        out.remarks.append(f"it ends early: {trial.first.failure}")


def _declared(trial: _Trial, out: Check) -> None:
    trace, backend = trial.first, trial.backend
    for channel in backend.channels:
        if channel.name not in trace.channels:
            out.violations.append(f"{channel.name} is declared, but is not in the trace")
            continue
        width = trace[channel.name].reshape(len(trace), -1).shape[1]
        if width != channel.width:
            out.violations.append(
                f"{channel.name} has {width} columns in the trace, but {channel.width} declared"
            )
        unit = trace.units.get(channel.name, channel.unit)
        if unit != channel.unit:
            out.violations.append(
                f"{channel.name} is in {unit or '1'} in the trace, but in {channel.unit or '1'} declared"
            )
        if not np.isfinite(trace[channel.name]).all():
            out.remarks.append(f"{channel.name} has samples that are not finite")
    step = float(np.diff(trace.times).max()) if len(trace) > 1 else 0.0
    if (
        trace.failure is None
        and not isinstance(backend, HasRecordings)
        and abs(trace.duration - backend.duration) > SLACK * step
    ):
        out.violations.append(
            f"a rollout lasts {trace.duration:g} s, but its duration is {backend.duration:g} s"
        )


def _repeated(trial: _Trial, out: Check) -> None:
    if not trial.backend.deterministic:
        out.remarks.append(
            "it promises no such thing: no rollout can be replayed, and an effect of little is not seen"
        )
    elif not _same(trial.first, _rollout(trial.backend, trial.test)):
        out.violations.append("two rollouts with one seed differ; draw all random numbers from the seed")


def _ends(trial: _Trial, out: Check) -> None:
    if isinstance(trial.backend, HasRecordings):
        out.remarks.append("its tests are those that were recorded")
        return
    for p in trial.backend.parameters:
        for value in dict.fromkeys((p.low, p.high)):
            _tried(
                out, f"{p.name} = {value:g} {p.unit}".rstrip(), trial.backend, {**trial.test, p.name: value}
            )


def _tried(out: Check, at: str, machine: Backend, test: Mapping[str, float]) -> Trace | None:
    """Run a test; an exception is a violation, an early end a remark."""
    try:
        trace = _rollout(machine, test)
    except Exception as error:
        out.violations.append(
            f"{at}: {_described(error)}; a rollout that cannot go on ends with meta['failure']"
        )
        return None
    if trace.failure is not None:
        out.remarks.append(f"{at}: ends early ({trace.failure})")
    return trace


def _catalogue(trial: _Trial, out: Check) -> None:
    names = Counter(effect.name for effect in trial.effects)
    out.violations += [
        f"the effect {name} is declared {count} times" for name, count in names.items() if count > 1
    ]
    out.violations += [
        f"{effect.name} has no parameters" for effect in trial.effects if not effect.parameters
    ]


def _nominal(trial: _Trial, out: Check) -> None:
    if not trial.backend.deterministic:
        out.remarks.append("not tried: no two rollouts are the same")
        return
    for effect in trial.effects:
        values = {effect.name: {p.name: p.nominal for p in effect.parameters}}
        if not _same(trial.first, _rollout(trial.added(values), trial.test)):
            out.violations.append(f"{effect.name} changes the trace though it is not there")


def _ranges(trial: _Trial, out: Check) -> None:
    for effect in trial.effects:
        changed = False
        for p in effect.parameters:
            for value in dict.fromkeys((p.low, p.high)):
                # What says only how an effect acts does so where there is some of it.
                values = {effect.name: {**trial.there[effect.name][effect.name], p.name: value}}
                words = ", ".join(f"{name}={x:g}" for name, x in values[effect.name].items())
                trace = _tried(out, f"{effect.name} with {words}", trial.added(values), trial.test)
                changed = changed or trace is None or not _same(trial.first, trace)
        if not changed:
            out.violations.append(
                f"{effect.name} changes nothing in the default test, wherever in its range it is"
            )


def _order(trial: _Trial, out: Check) -> None:
    for one, other in pairwise(trial.there):
        machines = [
            trial.added(trial.there[last], trial.added(trial.there[first]))
            for first, last in ((one, other), (other, one))
        ]
        traces = [_tried(out, f"{one} and {other}", machine, trial.test) for machine in machines]
        if trial.backend.deterministic and None not in traces and not _same(*traces):  # type: ignore[arg-type]
            out.violations.append(f"{one} and {other} do not give what {other} and {one} give")
    everything = {name: values for one in trial.there.values() for name, values in one.items()}
    _tried(out, "all effects together", trial.added(everything), trial.test)


def _draws(trial: _Trial, out: Check) -> None:
    if not trial.backend.deterministic:
        out.remarks.append("not tried: no two rollouts are the same")
        return
    seeds = _apart(trial.first, trial.backend.rollout(trial.test, SEED + 1))
    noisy = [name for name, change in seeds.items() if change > 0.0]
    for effect in trial.effects if noisy else ():
        values = {effect.name: {p.name: _towards(p, VERY_LITTLE) for p in effect.parameters}}
        trace = _tried(out, f"next to nothing of {effect.name}", trial.added(values), trial.test)
        if trace is not None and trace.channels.keys() == trial.first.channels.keys():
            change = _apart(trial.first, trace)
            if np.median([change[name] / seeds[name] for name in noisy]) > OTHERWISE:
                out.violations.append(
                    f"next to nothing of {effect.name} changes as much as another seed; draw all random numbers "
                    f"before anything that depends on an effect"
                )


def _variants(trial: _Trial, out: Check) -> None:
    assert isinstance(trial.backend, HasVariants)
    for name, machine in trial.backend.variants().items():
        trace = _tried(out, f"the variant {name!r}", machine, trial.test)
        if trace is None:
            continue
        if trace.channels.keys() != trial.first.channels.keys():
            out.violations.append(f"the variant {name!r} has other channels")
        elif trial.backend.deterministic and _same(trial.first, trace):
            out.violations.append(f"the variant {name!r} is the simulator itself")
        if machine.model_hash == trial.backend.model_hash:
            out.violations.append(
                f"the model hash does not change with the variant {name!r}: its rollouts would be mixed up"
            )


def _identity(trial: _Trial, out: Check) -> None:
    if not isinstance(trial.backend, HasChosen):
        out.remarks.append("it has no chosen(): effects that it was given count as absent in a diagnosis")
    for name, values in trial.there.items():
        machine = trial.added(values)
        less = {name: {p: HALF * (x + _nominal_of(trial, name, p)) for p, x in values[name].items()}}
        hashes = {trial.backend.model_hash, machine.model_hash, trial.added(less).model_hash}
        if len(hashes) < 3:
            out.violations.append(
                f"the model hash does not change with {name}: its rollouts would be mixed up"
            )
        if isinstance(machine, HasChosen):
            told, given = dict(machine.chosen().get(name, {})), values[name]
            if any(p not in told or not np.isclose(told[p], x) for p, x in given.items()):
                out.violations.append(f"chosen() says {told} of {name}, which was given {given}")


def _nominal_of(trial: _Trial, effect: str, parameter: str) -> float:
    return next(
        p.nominal for e in trial.effects if e.name == effect for p in e.parameters if p.name == parameter
    )


def _residuals(trial: _Trial, out: Check) -> None:
    unknown, hardly = [], []
    for name, values in trial.there.items():
        machine = trial.added(values)
        trace = _rollout(machine, trial.test)
        bare, knowing = (_left(each, trace, trial.test) for each in (trial.backend, machine))
        if {n: x.shape for n, x in bare.items()} != {n: x.shape for n, x in knowing.items()}:
            out.violations.append(f"with {name} they are at other instants than without")
            continue
        left = [
            _rms(knowing[n]) / max(_rms(x), 1e-300)
            for n, x in bare.items()
            if not np.array_equal(x, knowing[n], equal_nan=True)
        ]
        if not left:
            unknown.append(name)
        elif min(left) > KNOWN:
            hardly.append(f"{name} ({100 * min(left):.0f} %)")
    if unknown:
        out.remarks.append(
            f"they do not know {', '.join(unknown)}, at least in the default test: of these the equations say nothing"
        )
    if hardly:
        out.remarks.append(
            f"more than half of the residual remains with the effect in the model: {', '.join(hardly)}; "
            f"the equations say little about these effects in the default test"
        )


def _left(machine: Backend, trace: Trace, test: Mapping[str, float]) -> dict[str, FloatArray]:
    assert isinstance(machine, HasResiduals)
    return {name: np.asarray(values) for name, values in machine.residuals(trace, test).channels.items()}


def _rms(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else 0.0
