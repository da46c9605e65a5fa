"""Does the backend offer what the spec reads and sweeps? Said before anything runs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from s2r_spec.backend import Backend, HasRecordings
from s2r_spec.errors import BackendError, UsageError, one_of, suggest
from s2r_spec.lang.units import Unit, UnknownUnitError, parse_unit
from s2r_spec.spec import Spec


@dataclass(frozen=True)
class Matched:
    """How a spec and a backend fit together."""

    channels: tuple[str, ...]
    """Channels that the requirement reads."""
    conversions: Mapping[str, tuple[float, float]]
    """Parameter → (a, b): a number x of the spec is a·x + b for the backend."""
    fixed: Mapping[str, float]
    """Parameters that the spec gives one value, in the backend's unit."""

    def to_backend(self, point: Mapping[str, float]) -> dict[str, float]:
        """Return a test in the backend's units, fixed parameters included."""
        return dict(self.fixed) | {
            name: _convert(self.conversions[name], value) for name, value in point.items()
        }

    def to_spec(self, params: Mapping[str, float]) -> dict[str, float] | None:
        """Return the test, in the spec's units, of a backend's parameters; None if a fixed one differs."""
        for name, value in self.fixed.items():
            if not math.isclose(params[name], value, rel_tol=1e-9, abs_tol=1e-12):
                return None
        return {name: (params[name] - offset) / factor for name, (factor, offset) in self.conversions.items()}


def match(spec: Spec, requirement: str, backend: Backend) -> Matched:
    """Check signals, parameters, units and ranges.

    Raises:
        UsageError: a signal or parameter is unknown to the backend, its unit does not
            convert, or the range swept is wider than the backend can do.
        BackendError: the backend declares a unit that is none.
    """
    channels = {channel.name: channel for channel in backend.channels}
    for name in spec.channels(requirement):
        signal = spec.signals[name]
        if name not in channels:
            if name in (lacking := getattr(backend, "lacking", {})):
                raise UsageError(f"{spec.name} reads the signal {name!r}, but {lacking[name]}")
            raise UsageError(
                f"{spec.name} reads the signal {name!r}, which backend {backend.name!r} does not record"
                f"{suggest(name, channels)} it records {one_of(channels)}"
            )
        _conversion(f"signal {name!r}", signal.measure, channels[name].unit, backend.name)
        if channels[name].width != signal.dim:
            raise UsageError(
                f"{spec.name} declares the signal {name!r} with {signal.dim} components, "
                f"backend {backend.name!r} records {channels[name].width}"
            )
    # Recordings need not cover the test space: what they leave open is said in the certificate.
    bounded = not isinstance(backend, HasRecordings)
    offered = {parameter.name: parameter for parameter in backend.parameters}
    conversions: dict[str, tuple[float, float]] = {}
    fixed: dict[str, float] = {}
    for name, param in spec.params.items():
        if name not in offered:
            if param.searched:
                raise UsageError(
                    f"{spec.name} sweeps the parameter {name!r}, which backend {backend.name!r} does not have"
                    f"{suggest(name, offered)} it has {one_of(offered)}"
                )
            continue  # a number of the formulas only
        conversion = _conversion(f"parameter {name!r}", param.measure, offered[name].unit, backend.name)
        if param.searched and param.range:
            conversions[name] = conversion
            for end in param.range if bounded else ():
                offered[name].check(_convert(conversion, end))
        elif param.default is not None:
            fixed[name] = _convert(conversion, param.default)
            if bounded:
                offered[name].check(fixed[name])
    return Matched(spec.channels(requirement), conversions, fixed)


def _convert(conversion: tuple[float, float], value: float) -> float:
    factor, offset = conversion
    return factor * value + offset


def _conversion(what: str, declared: Unit, unit: str, backend: str) -> tuple[float, float]:
    if not unit:
        return 1.0, 0.0
    try:
        offered = parse_unit(unit)
    except UnknownUnitError:
        wrong = UsageError if backend.startswith("log:") else BackendError  # a file's mistake is its user's
        raise wrong(f"backend {backend!r} declares {what} in {unit!r}, which is not a unit") from None
    if not declared.fits(offered):
        raise UsageError(
            f"the spec declares {what} in {declared}, but backend {backend!r} has it in {offered}; "
            f"these do not convert into each other"
        )
    return declared.to(offered)
