"""Whether a backend keeps what it promises: channels, seeds, ranges, effects. For whoever writes one.

Every promise is tried by rollouts of the backend's default test, and of the ends of what it says it can do.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from s2r_spec.backend import Backend, Effect, EffectParameter, HasChosen, HasEffects, HasResiduals
from s2r_spec.errors import S2RError
from s2r_spec.trace import Trace

SEED = 1
HALF = 0.5
"""Where effects are tried: this part of the way from nominal to the farther end of the range."""
KNOWN = 0.5
"""A residual that knows an effect leaves less than this part of what the nominal model leaves of a rollout with it."""
SLACK = 1.5
"""In samples: by how much a rollout may be shorter or longer than the backend says."""

Values = Mapping[str, Mapping[str, float]]


@dataclass
class Promise:
    """One promise.

    Attributes:
        words: what is promised.
        broken: where it is not kept, a sentence each.
        remarks: what is no breach, but may not be meant.
    """

    words: str
    broken: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)


def promises(backend: Backend) -> Iterator[Promise]:
    """Try every promise that the backend makes, one after the other."""
    test = {p.name: p.default for p in backend.parameters}
    first, error = _run(backend, test)
    runs = Promise("its default test runs")
    if first is None:
        runs.broken.append(error)
        yield runs
        return
    if first.failure is not None:
        runs.remarks.append(f"it ends early: {first.failure}")
    yield runs
    yield _as_declared(backend, first)
    yield _repeated(backend, test, first)
    yield _ends(backend, test)
    if isinstance(backend, HasEffects) and backend.effects():
        yield _nominal(backend, test, first)
        yield _ranges(backend, backend.effects(), test, first)
        yield _order(backend, test)
        yield _told(backend)
        if isinstance(backend, HasResiduals):
            yield _residuals(backend, test)


def _run(
    backend: Backend, test: Mapping[str, float], seed: int = SEED
) -> tuple[Trace, str] | tuple[None, str]:
    try:
        return backend.rollout(test, seed), ""
    except Exception as error:
        return None, f"{type(error).__name__}: {error}"


def _same(one: Trace, other: Trace) -> bool:
    """Return whether two traces are the same, bit for bit."""
    return (
        one.channels.keys() == other.channels.keys()
        and np.array_equal(one.times, other.times)
        and all(np.array_equal(values, other[name], equal_nan=True) for name, values in one.channels.items())
    )


def _as_declared(backend: Backend, trace: Trace) -> Promise:
    out = Promise("its traces have the channels that it declares, and last as long as it says")
    for channel in backend.channels:
        if channel.name not in trace.channels:
            out.broken.append(f"{channel.name} is declared, but is not in the trace")
            continue
        width = trace[channel.name].reshape(len(trace), -1).shape[1]
        if width != channel.width:
            out.broken.append(
                f"{channel.name} has {width} columns in the trace, but {channel.width} declared"
            )
        if (unit := trace.units.get(channel.name, channel.unit)) != channel.unit:
            out.broken.append(
                f"{channel.name} is in {unit or '1'} in the trace, but in {channel.unit or '1'} declared"
            )
        if not np.isfinite(trace[channel.name]).all():
            out.remarks.append(f"{channel.name} has samples that are not finite")
    step = float(np.diff(trace.times).max()) if len(trace) > 1 else 0.0
    if trace.failure is None and abs(float(trace.times[-1]) - backend.duration) > SLACK * step:
        out.broken.append(
            f"a rollout ends at {trace.times[-1]:g} s, but its duration is {backend.duration:g} s"
        )
    return out


def _repeated(backend: Backend, test: Mapping[str, float], first: Trace) -> Promise:
    out = Promise("test and seed fix a trace, bit for bit")
    again, error = _run(backend, test)
    if not backend.deterministic:
        out.remarks.append("it says that they do not: no rollout can be replayed")
    elif again is None:
        out.broken.append(f"the second rollout raised {error}")
    elif not _same(first, again):
        out.broken.append("two rollouts with one seed differ; draw all random numbers from the seed")
    return out


def _ends(backend: Backend, test: Mapping[str, float]) -> Promise:
    out = Promise("every test parameter can be what its range says")
    for p in backend.parameters:
        for value in dict.fromkeys((p.low, p.high)):
            trace, error = _run(backend, {**test, p.name: value})
            at = f"{p.name} = {value:g} {p.unit}".rstrip()
            if trace is None:
                out.broken.append(f"{at}: {error}")
            elif trace.failure is not None:
                out.remarks.append(f"{at}: ends early ({trace.failure})")
    return out


def _nominal(backend: HasEffects, test: Mapping[str, float], first: Trace) -> Promise:
    out = Promise("an effect at its nominal values changes no bit")
    for effect in backend.effects():
        values = {effect.name: {p.name: _here(backend, effect, p) for p in effect.parameters}}
        trace, error = _added(backend, values, test)
        if trace is None:
            out.broken.append(f"{effect.name}: {error}")
        elif not _same(first, trace):
            out.broken.append(f"{effect.name} changes the trace though it is not there")
    return out


def _ranges(
    backend: HasEffects, effects: tuple[Effect, ...], test: Mapping[str, float], first: Trace
) -> Promise:
    out = Promise("every effect can be what its range says, and does something there")
    for effect in effects:
        changed = False
        for p in effect.parameters:
            for value in dict.fromkeys((p.low, p.high)):
                trace, error = _added(backend, {effect.name: {p.name: value}}, test)
                at = f"{effect.name}.{p.name} = {value:g} {p.unit}".rstrip()
                if trace is None:
                    out.broken.append(f"{at}: {error}; a rollout that cannot go on ends with meta['failure']")
                    continue
                changed = changed or not _same(first, trace)
                if trace.failure is not None:
                    out.remarks.append(f"{at}: ends early ({trace.failure})")
        if not changed:
            out.broken.append(
                f"{effect.name} changes nothing in the default test, wherever in its range it is"
            )
    return out


def _order(backend: HasEffects, test: Mapping[str, float]) -> Promise:
    out = Promise("the order in which effects are added changes nothing")
    for one, other in pairwise(backend.effects()):
        traces = []
        for values in ((one, other), (other, one)):
            machine = backend
            for effect in values:
                machine = machine.with_effects(_half(backend, effect))
            traces.append(_run(machine, test)[0] if isinstance(machine, Backend) else None)
        if traces[0] is not None and traces[1] is not None and not _same(traces[0], traces[1]):
            out.broken.append(
                f"{one.name} and {other.name} do not give what {other.name} and {one.name} give"
            )
    return out


def _told(backend: HasEffects) -> Promise:
    out = Promise("a machine with an effect has another hash, and says what it was given")
    if not isinstance(backend, HasChosen):
        out.remarks.append("it has no chosen(): effects that it was given count as absent in a diagnosis")
    for effect in backend.effects():
        values = _half(backend, effect)
        machine = backend.with_effects(values)
        if getattr(machine, "model_hash", None) == getattr(backend, "model_hash", ""):
            out.broken.append(
                f"the model hash does not change with {effect.name}: its rollouts would be mixed up"
            )
        if isinstance(machine, HasChosen):
            told, given = dict(machine.chosen().get(effect.name, {})), values[effect.name]
            if any(name not in told or not np.isclose(told[name], value) for name, value in given.items()):
                out.broken.append(f"chosen() says {told} of {effect.name}, which was given {given}")
    return out


def _residuals(backend: HasEffects, test: Mapping[str, float]) -> Promise:
    out = Promise("its residuals can be computed of its own rollouts, whatever effects are added")
    strange = []
    for effect in backend.effects():
        machine = backend.with_effects(_half(backend, effect))
        trace, _ = _run(machine, test) if isinstance(machine, Backend) else (None, "")
        if trace is None:
            continue
        try:
            bare, with_it = (_left(each, trace, test) for each in (backend, machine))
        except S2RError as error:
            out.broken.append(f"with {effect.name}: {error}")
            continue
        if {name: values.shape for name, values in bare.items()} != {n: v.shape for n, v in with_it.items()}:
            out.broken.append(f"with {effect.name} they are at other instants than without")
            continue
        # In units of what is left without it, no residual outweighs the others.
        whole = {name: float(np.sqrt(np.nanmean(values**2))) for name, values in bare.items()}
        changed = [
            name for name, values in with_it.items() if not np.array_equal(values, bare[name], equal_nan=True)
        ]
        after = [
            float(np.sqrt(np.nanmean(with_it[name] ** 2))) / max(whole[name], 1e-300) for name in changed
        ]
        if not changed or min(after) > KNOWN:
            strange.append(effect.name)
    if strange:
        out.remarks.append(
            f"in the default test they do not know {', '.join(strange)}: with the effect in the model they leave as "
            f"much as without, so the equations of motion cannot be asked for it there"
        )
    return out


def _left(machine: object, trace: Trace, test: Mapping[str, float]) -> dict[str, np.ndarray]:
    assert isinstance(machine, HasResiduals)
    found = machine.residuals(trace, test)
    return {name: np.asarray(values) for name, values in found.channels.items()}


def _half(backend: HasEffects, effect: Effect) -> dict[str, dict[str, float]]:
    """Return the effect, there by its first parameter."""
    first = effect.parameters[0]
    here = _here(backend, effect, first)
    end = first.high if first.high - here >= here - first.low else first.low
    return {effect.name: {first.name: here + HALF * (end - here)}}


def _here(backend: HasEffects, effect: Effect, parameter: EffectParameter) -> float:
    """Return where the backend is as it stands: nominal, or what it was given."""
    chosen = backend.chosen() if isinstance(backend, HasChosen) else {}
    return float(chosen.get(effect.name, {}).get(parameter.name, parameter.nominal))


def _added(
    backend: HasEffects, values: Values, test: Mapping[str, float]
) -> tuple[Trace, str] | tuple[None, str]:
    try:
        machine = backend.with_effects(values)
    except Exception as error:
        return None, f"{type(error).__name__}: {error}"
    assert isinstance(machine, Backend)
    return _run(machine, test)
