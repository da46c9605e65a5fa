"""``s2r gap``: how far simulator and real machine are apart, with sign and probability.

A gap has no verdict: 0 says that the interval is as narrow as asked, 3 that it is not.
"""

from __future__ import annotations

from s2r_spec.cli.against import Search, against


def _search() -> Search:
    from s2r_spec.certify.gap import gap as bound
    from s2r_spec.report import gapped
    from s2r_spec.report.recompute import recompute_gap
    from s2r_spec.rollouts.layout import SYSTEMS

    return Search(bound, gapped.report, lambda folder, _: recompute_gap(folder), SYSTEMS)


gap = against("gap-", "Bound the signed gap Δ = ρ_real − ρ_sim over the spec's test space.", _search)
