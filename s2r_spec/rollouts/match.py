"""Does the backend offer what the spec reads and sweeps? Said before anything runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from s2r_spec.backend import Backend
from s2r_spec.errors import UsageError, did_you_mean, one_of
from s2r_spec.lang import units
from s2r_spec.spec import Spec


@dataclass(frozen=True)
class Matched:
    """How a spec and a backend fit together."""

    channels: tuple[str, ...]
    """Channels that the requirement reads."""
    factors: Mapping[str, float]
    """Parameter → factor from the spec's unit to the backend's."""
    fixed: Mapping[str, float]
    """Parameters that the spec gives one value, in the backend's unit."""

    def to_backend(self, point: Mapping[str, float]) -> dict[str, float]:
        """Return a test in the backend's units, fixed parameters included."""
        return dict(self.fixed) | {name: value * self.factors[name] for name, value in point.items()}


def match(spec: Spec, requirement: str, backend: Backend) -> Matched:
    """Check signals, parameters, units and ranges.

    Raises:
        UsageError: a signal or parameter is unknown to the backend, its unit does not
            convert, or the range swept is wider than the backend can do.
    """
    channels = {channel.name: channel for channel in backend.channels}
    for name in spec.channels(requirement):
        signal = spec.signals[name]
        if name not in channels:
            raise UsageError(
                f"{spec.name} reads the signal {name!r}, which backend {backend.name!r} does not record"
                f"{did_you_mean(name, channels)} it records {one_of(channels)}"
            )
        _factor(f"signal {name!r}", channels[name].unit, signal.unit, backend.name)
        if channels[name].width != (signal.dim or 1):
            raise UsageError(
                f"{spec.name} declares the signal {name!r} with {signal.dim or 1} components, "
                f"backend {backend.name!r} records {channels[name].width}"
            )
    offered = {parameter.name: parameter for parameter in backend.parameters}
    factors: dict[str, float] = {}
    for axis in spec.space.axes:
        if axis.name not in offered:
            raise UsageError(
                f"{spec.name} sweeps the parameter {axis.name!r}, which backend {backend.name!r} does not have"
                f"{did_you_mean(axis.name, offered)} it has {one_of(offered)}"
            )
        factors[axis.name] = _factor(f"parameter {axis.name!r}", axis.unit, offered[axis.name].unit, backend.name)
        for end in (axis.low, axis.high):
            offered[axis.name].check(end * factors[axis.name])
    fixed = {
        name: offered[name].check(
            value.default * _factor(f"parameter {name!r}", value.unit, offered[name].unit, backend.name)
        )
        for name, value in spec.params.items()
        if value.default is not None and name in offered
    }
    return Matched(spec.channels(requirement), factors, fixed)


def _factor(what: str, source: str, target: str, backend: str) -> float:
    """Return the factor from one unit to another; a missing unit on one side is no conversion."""
    if not source or not target or source == target:
        return 1.0
    factor = units.factor(source, target)
    if factor is None:
        raise UsageError(
            f"{what} is in {target} for one side and in {source} for the other (backend {backend!r}); "
            f"these do not convert into each other"
        )
    return factor
