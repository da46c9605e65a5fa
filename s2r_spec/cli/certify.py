"""``s2r certify``: what simulation and gap together promise about the real machine."""

from __future__ import annotations

from s2r_spec.cli.against import Search, against


def _search() -> Search:
    from s2r_spec.certify.real_machine import certify as both
    from s2r_spec.report import certified
    from s2r_spec.report.recompute import recompute_certify
    from s2r_spec.rollouts.layout import SIMULATION

    return Search(both, certified.report, recompute_certify, (SIMULATION,))


certify = against(
    "", "Certify the worst expected robustness in simulation, bound the gap, and add the two.", _search
)
