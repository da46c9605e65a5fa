"""Requirements on the protocols of a backend."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from s2r_spec.backend.protocols import PROTOCOL, Protocol
from s2r_spec.base.errors import UsageError
from s2r_spec.testing.subject import (
    SEED,
    Check,
    Checks,
    Subject,
    attempt,
    is_same,
    lasts,
    repeated,
    wrong_defaults,
)
from s2r_spec.trace import Trace


def _declared(subject: Subject, out: Check) -> None:
    offered = subject.backend.protocols()
    out.violations += repeated("protocol", (protocol.name for protocol in offered))
    for protocol in offered:
        if not (protocol.duration > 0.0 and protocol.cost > 0.0):
            out.violations.append(
                f"{protocol.name} has the duration {protocol.duration:g} s and the cost {protocol.cost:g} s; "
                f"both must be positive"
            )
        if not protocol.words:
            out.violations.append(f"{protocol.name} does not say in words what a person does")
        out.violations += wrong_defaults(protocol.parameters, f"{protocol.name}: ")


def _runs(subject: Subject, out: Check) -> None:
    for protocol in subject.backend.protocols():
        trace = _attempt(subject, out, protocol, {})
        if trace is None:
            continue
        if not lasts(trace, protocol.duration):
            out.violations.append(
                f"{protocol.name} lasts {trace.duration:g} s, but its declared duration is {protocol.duration:g} s"
            )
        again = _attempt(subject, out, protocol, {}) if subject.backend.deterministic else None
        if again is not None and not is_same(trace, again):
            out.violations.append(f"two runs of {protocol.name} with one seed differ")


def _ends(subject: Subject, out: Check) -> None:
    for protocol in subject.backend.protocols():
        for p in protocol.parameters:
            for value in dict.fromkeys((p.low, p.high)):
                _attempt(subject, out, protocol, {p.name: value})
        beyond = {p.name: p.high + 1.0 for p in protocol.parameters[:1]}
        for wrong in (beyond, {"no such parameter": 0.0}):
            if wrong and not _refuses(subject.backend, protocol.name, wrong):
                out.violations.append(f"{protocol.name} runs with {wrong} instead of raising a UsageError")


def _unknown(subject: Subject, out: Check) -> None:
    if not _refuses(subject.backend, "no such protocol", {}):
        out.violations.append("a protocol with an unknown name runs instead of raising a UsageError")


def _playable(subject: Subject, out: Check) -> None:
    for protocol in subject.backend.protocols():
        played = subject.backend.playable(protocol.name, {})
        shapes = {name: values.shape for name, values in played.channels.items()}
        missing = [name for name in ("q", "dq", "kp", "kd") if name not in shapes]
        if missing:
            out.violations.append(f"the references of {protocol.name} lack the channels {', '.join(missing)}")
        elif shapes["q"] != shapes["dq"] or not all(np.isfinite(x).all() for x in played.channels.values()):
            out.violations.append(f"the references of {protocol.name} differ in shape, or are not finite")


def _attempt(subject: Subject, out: Check, protocol: Protocol, params: Mapping[str, float]) -> Trace | None:
    at = f"{protocol.name} with {dict(params)}" if params else protocol.name
    trace = attempt(out, at, "run", lambda: subject.backend.run(protocol.name, params, SEED))
    if trace is not None and (named := trace.meta.get(PROTOCOL)) != protocol.name:
        out.violations.append(f"{at}: meta[{PROTOCOL!r}] is {named!r}, not the protocol's name")
    return trace


def _refuses(backend: Any, name: str, params: Mapping[str, float]) -> bool:
    try:
        backend.run(name, params, SEED)
    except UsageError:
        return True
    return False


PROTOCOLS: Checks = (
    ("every protocol has a name of its own, a duration, and valid parameters", _declared),
    ("every protocol runs, and its trace has its name and its duration", _runs),
    ("every parameter of a protocol runs at both ends of its range, and no further", _ends),
    ("a protocol that it does not offer is refused", _unknown),
)
PLAYABLE: Checks = (("the references of every protocol can be played", _playable),)
