"""The search that a specification's certify line declares."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from s2r_spec.base.errors import UsageError, one_of
from s2r_spec.certify.bound.kernels import Kernel
from s2r_spec.certify.bound.settings import SearchSettings
from s2r_spec.certify.options import RunOptions
from s2r_spec.certify.result.search_result import rho_unit
from s2r_spec.certify.search.pairing import SIMULATED_PER_REAL
from s2r_spec.certify.search.search import Search
from s2r_spec.runs.stop_rule import EPSILON
from s2r_spec.spec import CertifySettings, Spec


def search_for(spec: Spec, requirement: str, options: RunOptions) -> Search:
    """Return the search that a requirement's certify line declares.

    An unknown requirement, or a certify line that lacks a setting, is a UsageError.
    """
    require_space(spec, requirement)
    line: Any = spec.certify.get(requirement, CertifySettings())
    names = ("delta", "epsilon", "B", "R", "kernel", "fall")
    if lacking := [name for name in names if getattr(line, name) is None]:
        raise UsageError(
            f"the certificate of {requirement!r} needs {', '.join(lacking)}, declared before the data "
            f"in a line 'certify {requirement}: {lacking[0]} = …' of {spec.name}; `s2r pilot` proposes one"
        )
    return Search.of(
        SearchSettings(
            space=spec.space,
            kernel=Kernel(line.kernel.name, line.kernel.lengthscales),
            B=line.B,
            R=line.R,
            delta=line.delta,
            epsilon=line.epsilon,
            seed=options.fixed_seed,
            budget=options.budget,
            stop=options.stop or EPSILON,
            mode=options.mode,
            engine=options.engine,
            repeats=bool(options.repeats),
            unit=rho_unit(spec, requirement),
        )
    )


def of_gap(line: CertifySettings, per_real: int) -> CertifySettings:
    """Return the settings of the search of the gap, for k = ``per_real`` simulated rollouts for each real one.

    B and ε are ``gap_B`` and ``gap_epsilon``, or those of the line. The noise of Δ has the proxy sqrt(r² + R²/k), with
    proxies r of the machine and R of the simulator. ``gap_R`` declares it for :data:`SIMULATED_PER_REAL` simulated
    rollouts; without it r = R.
    """
    R = line.R
    if R is not None and line.gap_R is None:
        R *= math.sqrt(1 + 1 / per_real)
    elif R is not None and line.gap_R is not None:
        R = math.sqrt(line.gap_R**2 + R**2 * (1 / per_real - 1 / SIMULATED_PER_REAL))
    return CertifySettings(B=line.gap_B, epsilon=line.gap_epsilon, R=R).over(line)


def require_space(spec: Spec, requirement: str) -> None:
    """Refuse an unknown requirement, and a specification without a test space, with a UsageError."""
    if requirement not in spec.requirements:
        raise UsageError(
            f"{spec.name} has no requirement {requirement!r}; it has {one_of(spec.requirements)}"
        )
    if not spec.space.dim:
        raise UsageError(
            f"{spec.name} has no test space: declare a parameter with a range, "
            f"for example  param vd {{m/s}} in [-0.2, 0.3]"
        )


def only_requirement(spec: Spec) -> str:
    """Return the name of the spec's one requirement; a UsageError asks for a name if there are several."""
    if len(spec.requirements) != 1:
        raise UsageError(f"{spec.name} has several requirements ({one_of(spec.requirements)}): name one")
    return spec.requirements[0]


def certified_requirements(spec: Spec, names: Sequence[str] | None, options: RunOptions) -> list[str]:
    """Return the requirements that a run checks, the named ones or all with a certify line; a UsageError if none."""
    requirements = list(dict.fromkeys(names or [name for name in spec.requirements if name in spec.certify]))
    if not requirements:
        raise UsageError(f"{spec.name} has no certify line, so there is nothing to certify")
    for name in requirements:
        search_for(spec, name, options)
    return requirements
