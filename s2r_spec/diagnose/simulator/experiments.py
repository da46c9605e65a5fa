"""An experiment: a test of the specification or a protocol, with its parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from s2r_spec.backend import Backend, HasResiduals
from s2r_spec.backend.protocols import PROTOCOL, HasProtocols
from s2r_spec.base.errors import TraceError, UsageError
from s2r_spec.trace import Trace

RESIDUAL = "residual."
"""Definition: prefix of the channels that :func:`with_residuals` adds."""


@dataclass(frozen=True, order=True)
class Experiment:
    """One way to run the machine.

    Attributes:
        protocol: name of the protocol; "" for a test of the specification.
        params: (name, value) of its parameters in the backend's units, sorted by name.
    """

    protocol: str
    params: tuple[tuple[str, float], ...] = ()

    @classmethod
    def test(cls, params: Mapping[str, float]) -> Experiment:
        """Return a test of the specification."""
        return cls("", tuple(sorted(params.items())))

    @property
    def values(self) -> dict[str, float]:
        """Its parameters by name."""
        return dict(self.params)

    def __str__(self) -> str:
        """Return its name in words, such as ``air_sine`` or ``vd = 0.2``."""
        params = ", ".join(f"{name} = {value:.4g}" for name, value in self.params)
        return " ".join(filter(None, (self.protocol, params))) or "the test"

    def run(self, backend: Backend, seed: int) -> Trace:
        """Run it once.

        Raises:
            UsageError: the backend has no such protocol or parameter.
        """
        if not self.protocol:
            return backend.rollout(dict(self.params), seed)
        if not isinstance(backend, HasProtocols):
            raise UsageError(
                f"the backend {backend.name!r} has no protocols, so it cannot run {self.protocol!r}"
            )
        return backend.run(self.protocol, dict(self.params), seed)

    def with_residuals(self, trace: Trace, backend: Backend) -> Trace:
        """Return the trace with the residuals of a nominal simulator beside its channels."""
        if self.protocol:
            trace = replace(trace, meta=dict(trace.meta) | {PROTOCOL: self.protocol})
        return with_residuals(trace, backend, dict(self.params))


def with_residuals(trace: Trace, backend: Backend, params: Mapping[str, float]) -> Trace:
    """Return the trace with the residuals of a backend's own model beside its channels, at the trace's times.

    A residual has no value at the ends of a trace, where its filter lacks samples: it takes the nearest one there. A
    trace without the channels of any residual (a log of few channels, a fall at once) is returned as it is. ``params``
    are those of the test or of the protocol, in the backend's units.
    """
    if not isinstance(backend, HasResiduals):
        return trace
    try:
        residuals = backend.residuals(trace, params)
    except TraceError:
        return trace
    nearest = np.clip(np.searchsorted(residuals.times, trace.times - 1e-9), 0, len(residuals) - 1)
    channels = {RESIDUAL + name: values[nearest] for name, values in residuals.channels.items()}
    units = {RESIDUAL + name: unit for name, unit in residuals.units.items()}
    return Trace(trace.times, dict(trace.channels) | channels, dict(trace.units) | units, trace.meta)
