"""Check that a backend conforms to its protocol: channels, seeds, ranges, effects. For authors of backends.

Every check runs rollouts of the backend's default test, or at the ends of its declared ranges.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Any

import numpy as np

from s2r_spec.backend import (
    Backend,
    HasChosen,
    HasControlLaw,
    HasEffects,
    HasPreflight,
    HasRecordings,
    HasResiduals,
    HasVariants,
    NeedsSpec,
    is_exclusive,
)
from s2r_spec.backend.function import FunctionBackend
from s2r_spec.backend.protocols import HasPlayable, HasProtocols
from s2r_spec.base.errors import TraceError, UsageError
from s2r_spec.runs.passed import PassedBackend
from s2r_spec.runs.repeatability import check_here
from s2r_spec.runs.scorer import open_for_requirement
from s2r_spec.spec import Spec
from s2r_spec.testing.protocol_checks import PLAYABLE, PROTOCOLS
from s2r_spec.testing.subject import (
    HALF,
    SEED,
    Check,
    Checks,
    Subject,
    attempt,
    describe,
    is_same,
    lasts,
    repeated,
    rms,
    rollout,
    towards,
    wrong_defaults,
)
from s2r_spec.trace import Trace

TINY = 1e-6
"""Definition: size of a tiny effect, as a share of the distance from nominal to the farther end of its range."""
SEED_SHARE = 0.5
"""Tolerance: change of a channel by a tiny effect, as a share of its change by another seed."""
EXACT = 1e-6
"""Tolerance: difference between a command and its law, in parts of the command's range."""
EXPLAINED = 0.5
"""Tolerance: residual with the effect in the model, as a share of the residual without it."""


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
    subject = Subject(backend)
    checks = [check for needs, group in _GROUPS for check in group if _has(backend, needs)]
    for requirement, run in checks:
        check = Check(requirement)
        try:
            run(subject, check)
        except (Exception, SystemExit) as error:  # third-party code may raise anything
            check.violations.append(describe(error))
        yield check
        if check.violations and (requirement, run) in (_ALWAYS[0], _EFFECTS[0], PROTOCOLS[0]):
            return  # all others depend on it


def _has(backend: Backend, needs: tuple[type, ...]) -> bool:
    if HasEffects in needs and isinstance(backend, FunctionBackend) and not backend.effects:
        return False
    return all(isinstance(backend, one) for one in needs)


def _runs(subject: Subject, out: Check) -> None:
    parameters = subject.backend.parameters
    out.violations += repeated("parameter", (p.name for p in parameters)) + wrong_defaults(parameters)
    if isinstance(subject.backend, NeedsSpec) and not parameters:
        out.remarks.append(
            "it declares no parameters, so its function gets none; check_conformance(backend, spec) takes them from a "
            "spec"
        )
    if subject.first.failure is not None:
        out.remarks.append(f"it ends early: {subject.first.failure}")


def _declared(subject: Subject, out: Check) -> None:
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
    # the recordings, or a spec's horizon, replace the declared duration
    elsewhere = isinstance(backend, HasRecordings) or (
        backend.duration == 0 and isinstance(backend, NeedsSpec)
    )
    if not elsewhere and not lasts(trace, backend.duration):
        out.violations.append(
            f"a rollout lasts {trace.duration:g} s, but the declared duration is {backend.duration:g} s"
        )


def _repeats(subject: Subject, out: Check) -> None:
    backend, test = subject.backend, subject.test
    if not backend.deterministic:
        out.remarks.append(
            "it is declared as not deterministic: no rollout can be replayed, and small effects go unnoticed"
        )
        return
    if not is_same(subject.first, rollout(backend, test)):
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


def _ends(subject: Subject, out: Check) -> None:
    if isinstance(subject.backend, HasRecordings):
        out.remarks.append("it has only the recorded tests")
        return
    for p in subject.backend.parameters:
        for value in dict.fromkeys((p.low, p.high)):
            at = f"{p.name} = {value:g} {p.unit}".rstrip()
            _try(out, at, subject.backend, {**subject.test, p.name: value})


def _try(out: Check, at: str, backend: Any, test: Mapping[str, float]) -> Trace | None:
    return attempt(out, at, "rollout", lambda: rollout(backend, test))


def _variants(subject: Subject, out: Check) -> None:
    for name, variant in subject.backend.variants().items():
        trace = _try(out, f"the variant {name!r}", variant, subject.test)
        if trace is None:
            continue
        if trace.channels.keys() != subject.first.channels.keys():
            out.violations.append(f"the variant {name!r} has other channels")
        elif subject.backend.deterministic and is_same(subject.first, trace):
            out.violations.append(f"the variant {name!r} gives the simulator's own trace")
        if variant.model_hash == subject.backend.model_hash:
            out.violations.append(
                f"the variant {name!r} has the simulator's model hash, so its rollouts would be confused with the "
                f"simulator's"
            )


def _law(subject: Subject, out: Check) -> None:
    law = subject.backend.commands(subject.first, subject.test)
    for name, values in law.channels.items():
        known = np.isfinite(values)
        error = np.abs(values - subject.first[name])[known].max(initial=0.0)
        if error > EXACT * np.ptp(subject.first[name]):
            out.violations.append(f"its law is off by {error:.3g} in {name} of its own rollout")
        if not known.any():
            out.violations.append(f"its law says nothing of {name}")
    if not law.channels:
        out.violations.append("its law gives no command for its own rollout")


def _catalogue(subject: Subject, out: Check) -> None:
    out.violations += repeated("effect", (effect.name for effect in subject.effects))
    out.violations += [
        f"{effect.name} has no parameters" for effect in subject.effects if not effect.parameters
    ]


def _nominal(subject: Subject, out: Check) -> None:
    if not subject.backend.deterministic:
        out.remarks.append("not checked: the backend is not deterministic")
        return
    for effect in subject.effects:
        values = {effect.name: {p.name: p.nominal for p in effect.parameters}}
        if not is_same(subject.first, rollout(subject.with_effects(values), subject.test)):
            out.violations.append(f"{effect.name} changes the trace at its nominal values")


def _ranges(subject: Subject, out: Check) -> None:
    for effect in subject.effects:
        changed = False
        for p in effect.parameters:
            for value in dict.fromkeys((p.low, p.high)):
                # A parameter of an effect's shape matters only if the effect has some size.
                values = {effect.name: {**subject.half_effects[effect.name][effect.name], p.name: value}}
                words = ", ".join(f"{name}={x:g}" for name, x in values[effect.name].items())
                backend = subject.with_effects(values)
                trace = _try(out, f"{effect.name} with {words}", backend, subject.test)
                changed = changed or trace is None or not is_same(subject.first, trace)
        if not changed:
            # The catalogue of a robot's files is not the user's, who may have a robot that an effect does not touch.
            place = out.remarks if isinstance(subject.backend, HasPreflight) else out.violations
            place.append(f"{effect.name} changes nothing in the default test, at either end of its range")


def _order(subject: Subject, out: Check) -> None:
    half = subject.half_effects
    for one, other in pairwise(half):
        backends = [
            subject.with_effects(half[last], subject.with_effects(half[first]))
            for first, last in ((one, other), (other, one))
        ]
        traces = [_try(out, f"{one} and {other}", backend, subject.test) for backend in backends]
        if subject.backend.deterministic and None not in traces and not is_same(*traces):  # type: ignore[arg-type]
            out.violations.append(f"the order matters: {one} and {other} differ from {other} and {one}")
    everything = {name: values for one in half.values() for name, values in one.items()}
    _try(out, "all effects together", subject.with_effects(everything), subject.test)


def _draws(subject: Subject, out: Check) -> None:
    if not subject.backend.deterministic:
        out.remarks.append("not checked: the backend is not deterministic")
        return
    seeds = _rms_difference(subject.first, subject.backend.rollout(subject.test, SEED + 1))
    noisy = [name for name, change in seeds.items() if change > 0.0]
    for effect in subject.effects if noisy else ():
        values = {effect.name: {p.name: towards(p, TINY) for p in effect.parameters}}
        trace = _try(out, f"a tiny {effect.name}", subject.with_effects(values), subject.test)
        if trace is not None and trace.channels.keys() == subject.first.channels.keys():
            change = _rms_difference(subject.first, trace)
            if np.median([change[name] / seeds[name] for name in noisy]) > SEED_SHARE:
                out.violations.append(
                    f"a tiny {effect.name} changes the trace as much as another seed does; draw all random numbers "
                    f"before any code that depends on an effect"
                )


def _identity(subject: Subject, out: Check) -> None:
    if not isinstance(subject.backend, HasChosen):
        out.remarks.append("it has no chosen(), so a diagnosis does not know its added effects")
    nominal = {(effect.name, p.name): p.nominal for effect in subject.effects for p in effect.parameters}
    for name, values in subject.half_effects.items():
        changed, added = subject.with_effects(values), values[name]
        less = {name: {p: HALF * (x + nominal[name, p]) for p, x in added.items()}}
        hashes = {subject.backend.model_hash, changed.model_hash, subject.with_effects(less).model_hash}
        if len(hashes) < 3:
            out.violations.append(
                f"the model hash does not depend on {name}, so rollouts with it would be confused with others"
            )
        if isinstance(changed, HasChosen):
            reported = dict(changed.chosen().get(name, {}))
            if any(p not in reported or not np.isclose(reported[p], x) for p, x in added.items()):
                out.violations.append(f"chosen() reports {reported} for {name}, but {added} was added")


def _residuals(subject: Subject, out: Check) -> None:
    try:
        subject.backend.residuals(rollout(subject.backend, subject.test), subject.test)
    except TraceError as error:
        out.remarks.append(f"the default test has no residuals: {error}")
        return
    insensitive, weak = [], []
    for name, values in subject.half_effects.items():
        changed = subject.with_effects(values)
        trace = rollout(changed, subject.test)
        nominal, modelled = (
            {n: np.asarray(x) for n, x in backend.residuals(trace, subject.test).channels.items()}
            for backend in (subject.backend, changed)
        )
        if {n: x.shape for n, x in nominal.items()} != {n: x.shape for n, x in modelled.items()}:
            out.violations.append(f"{name} changes the channels or the times of the residuals")
            continue
        shares = [
            rms(modelled[n]) / max(rms(x), 1e-300)
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


def _rms_difference(one: Trace, other: Trace) -> dict[str, float]:
    """Return channel → rms difference of two traces, over the length of the shorter one."""
    size = min(len(one), len(other))
    return {name: rms(values[:size] - other[name][:size]) for name, values in one.channels.items()}


_ALWAYS: Checks = (
    ("its default test runs", _runs),
    ("its traces have the declared channels and the declared duration", _declared),
    ("test and seed determine a trace, bit for bit, whatever ran before it", _repeats),
    ("every test parameter runs at both ends of its range", _ends),
)
_EFFECTS: Checks = (
    ("every effect has parameters, with valid ranges and priors", _catalogue),
    ("an effect at its nominal values changes no bit", _nominal),
    ("every effect runs at both ends of its range, and changes the trace", _ranges),
    ("effects can be added together, in any order", _order),
    ("its random numbers do not depend on effects", _draws),
    ("an added effect changes the model hash, and is reported", _identity),
)
_RESIDUALS = "its residuals can be computed for its own rollouts, with any effect"
_LAW = "the law of its controller gives the commands of its own rollout"
_VARIANTS = "its variants simulate the same system in another way"
_GROUPS: tuple[tuple[tuple[type, ...], Checks], ...] = (
    ((), _ALWAYS),
    ((HasEffects,), _EFFECTS),
    ((HasEffects, HasResiduals), ((_RESIDUALS, _residuals),)),
    ((HasProtocols,), PROTOCOLS),
    ((HasProtocols, HasPlayable), PLAYABLE),
    ((HasVariants,), ((_VARIANTS, _variants),)),
    ((HasControlLaw,), ((_LAW, _law),)),
)
"""What a backend must be able to do, and the checks of it."""
