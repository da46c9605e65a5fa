"""Check before any rollout that a backend has the signals and parameters of a spec."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from s2r_spec.backend import Backend, HasRecordings
from s2r_spec.base.errors import BackendError, UsageError, one_of, suggest
from s2r_spec.lang.conversion import Conversion
from s2r_spec.lang.units import Unit, UnknownUnitError, unit_in_log
from s2r_spec.recordings.recorded import tests_of
from s2r_spec.spec import Spec


@dataclass(frozen=True)
class Interface:
    """The channels and parameters that a spec and a backend share, with conversions of units."""

    channels: tuple[str, ...]
    """Channels that the requirement reads."""
    conversions: Mapping[str, Conversion]
    """Swept parameter → conversion from the spec's unit to the backend's."""
    fixed: Mapping[str, float]
    """Parameter → its one value in the spec, in the backend's unit."""

    def to_backend(self, point: Mapping[str, float]) -> dict[str, float]:
        """Return a test in the backend's units, with the fixed parameters."""
        return dict(self.fixed) | {name: self.conversions[name](value) for name, value in point.items()}

    def to_spec(self, params: Mapping[str, float]) -> dict[str, float] | None:
        """Return a backend's parameters as a test in the spec's units; None if a fixed parameter differs."""
        for name, value in self.fixed.items():
            if not math.isclose(params[name], value, rel_tol=1e-9, abs_tol=1e-12):
                return None
        return {name: conversion.back(params[name]) for name, conversion in self.conversions.items()}


def check_compatibility(spec: Spec, requirement: str, backend: Backend) -> Interface:
    """Check signals, parameters, units and ranges, and return the common interface.

    Raises:
        UsageError: the backend lacks a signal or a parameter, a unit does not convert, or a range of the spec exceeds
            the backend's range; or all its recordings are runs of protocols.
        BackendError: the backend declares an unknown unit.
    """
    if isinstance(backend, HasRecordings) and not tests_of(backend.recordings):
        raise UsageError(
            f"all {len(backend.recordings)} recordings of {backend.name} are runs of protocols, and {spec.name} needs "
            f"recorded tests; add some"
        )
    channels = {channel.name: channel for channel in backend.channels}
    for name in spec.channels(requirement):
        signal = spec.signals[name]
        if name not in channels:
            if name in (lacking := getattr(backend, "lacking", {})):
                raise UsageError(f"{spec.name} reads the signal {name!r}, but {lacking[name]}")
            raise UsageError(
                f"{spec.name} reads the signal {name!r}, which the backend {backend.name!r} does not record"
                f"{suggest(name, channels)} it records {one_of(channels)}"
            )
        _conversion(f"signal {name!r}", signal.measure, channels[name].unit, backend.name)
        if channels[name].width != signal.dim:
            raise UsageError(
                f"{spec.name} declares the signal {name!r} with {signal.dim} components, but the backend "
                f"{backend.name!r} records {channels[name].width}; change the declaration"
            )
    # Recordings need not cover the test space: the certificate says which part they leave open.
    bounded = not isinstance(backend, HasRecordings)
    offered = {parameter.name: parameter for parameter in backend.parameters}
    conversions: dict[str, Conversion] = {}
    fixed: dict[str, float] = {}
    for name, param in spec.params.items():
        if name not in offered:
            if param.searched:
                raise UsageError(
                    f"{spec.name} sweeps the parameter {name!r}, which the backend {backend.name!r} does not have"
                    f"{suggest(name, offered)} it has {one_of(offered)}"
                )
            continue  # only the formulas use it
        conversion = _conversion(f"parameter {name!r}", param.measure, offered[name].unit, backend.name)
        if param.searched and param.range:
            conversions[name] = conversion
            for end in param.range if bounded else ():
                offered[name].check(conversion(end))
        elif param.default is not None:
            fixed[name] = conversion(param.default)
            if bounded:
                offered[name].check(fixed[name])
    return Interface(spec.channels(requirement), conversions, fixed)


def _conversion(what: str, declared: Unit, unit: str, backend: str) -> Conversion:
    if not unit:
        return Conversion()
    try:
        offered = unit_in_log(unit, declared)
    except UnknownUnitError:
        wrong = UsageError if backend.startswith("log:") else BackendError  # a user writes the units of a log
        raise wrong(
            f"the backend {backend!r} declares the {what} in {unit!r}, which is not a unit such as m/s"
        ) from None
    if not declared.fits(offered):
        raise UsageError(
            f"the spec declares the {what} in {declared}, but the backend {backend!r} has it in {offered}. "
            f"{declared.two_readings(offered) or f'Declare a unit that converts to {offered}'}"
        )
    return declared.to(offered)
