"""``s2r gap``: bound the gap between simulator and real machine, with its sign and probability.

A gap has no verdict. Exit code 0 means that its interval is at most ε wide, 3 that it is wider.
"""

from __future__ import annotations

from s2r_spec.cli.options.against import Search, against


def _search() -> Search:
    from s2r_spec.certify.gap import gap as bound
    from s2r_spec.runs.layout import SYSTEMS

    return bound, SYSTEMS, SYSTEMS


gap = against(
    "gap-",
    "Bound the signed gap Δ = ρ_real − ρ_sim over the spec's test space. Exit code 3 if the interval is wider than ε.",
    _search,
)
