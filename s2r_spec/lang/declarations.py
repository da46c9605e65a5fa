"""The declarations of a checked specification as records, in their declared units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

from s2r_spec.lang.formula import Formula
from s2r_spec.lang.source import Source, Span
from s2r_spec.lang.units import PLAIN, Unit


@dataclass(frozen=True)
class Signal:
    """``signal vx {m/s} in [-1, 1]``.

    Args:
        name: channel of the trace.
        unit: the declared unit; "" if there is none.
        dim: number of components; 1 for a plain signal.
        range: (low, high) in the unit, or None.
        vector: whether a dimension was declared, so that the channel is (n, dim).
        boolean: whether it is declared bool: its samples are 0 and 1, and it is a condition.
    """

    name: str
    unit: str
    dim: int
    range: tuple[float, float] | None
    vector: bool
    boolean: bool = False
    measure: Unit = field(repr=False, default=PLAIN)
    span: Span | None = field(repr=False, compare=False, default=None)


@dataclass(frozen=True)
class Param:
    """``param vd {m/s} in [-0.2, 0.3]``: searched over its range unless it has a default."""

    name: str
    unit: str
    range: tuple[float, float] | None
    default: float | None
    measure: Unit = field(repr=False, default=PLAIN)
    span: Span | None = field(repr=False, compare=False, default=None)

    @property
    def searched(self) -> bool:
        """Whether it is an axis of the test space."""
        return self.range is not None and self.default is None


KernelName = Literal["rbf", "matern32", "matern52"]


@dataclass(frozen=True)
class KernelChoice:
    """Kernel of E ρ over the test space: its name, and one lengthscale for each axis, in the parameters' units."""

    name: KernelName
    lengthscales: tuple[float, ...]


@dataclass(frozen=True)
class CertifySettings:
    """One ``certify`` line; a setting that is not given is None. epsilon, B, R and fall are in the unit of ρ.

    Args:
        delta: probability that the certificate is wrong, in (0, 1).
        epsilon: width of the interval at which the search stops, > 0.
        B: bound on the norm of E ρ in the RKHS of the kernel, > 0.
        R: sub-Gaussian bound on the noise of one rollout, > 0; declared, never fitted.
        kernel: see :class:`KernelChoice`.
        fall: ρ of a rollout that failed.
        gap_B: bound on the norm of the gap E Δ in the same space, > 0; None for B.
        gap_R: sub-Gaussian bound on the noise of one Δ, a real ρ minus the mean of two simulated ones, > 0; None for
            the value that follows if R is the machine's, too.
        gap_epsilon: width of the interval at which the search of the gap stops, > 0; None for epsilon.
    """

    delta: float | None = None
    epsilon: float | None = None
    B: float | None = None
    R: float | None = None
    kernel: KernelChoice | None = None
    fall: float | None = None
    gap_B: float | None = None
    gap_R: float | None = None
    gap_epsilon: float | None = None

    def over(self, general: CertifySettings) -> CertifySettings:
        """Return these settings, completed by the settings of ``general``."""
        stated = {key: value for key, value in vars(self).items() if value is not None}
        return replace(general, **stated)


@dataclass(frozen=True)
class Document:
    """A specification without mistakes."""

    source: Source
    imports: tuple[Source, ...]
    signals: Mapping[str, Signal]
    params: Mapping[str, Param]
    requirements: Mapping[str, Formula]
    certify: Mapping[str, CertifySettings]
