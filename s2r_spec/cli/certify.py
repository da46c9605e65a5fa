"""``s2r certify``: bound the real machine's worst case by the simulation's bound plus the gap's."""

from __future__ import annotations

from s2r_spec.cli.options.against import SearchOptions, against


def _search() -> SearchOptions:
    from s2r_spec.certify.real_machine import certify as both
    from s2r_spec.report import certify as certify_report
    from s2r_spec.report.recompute import recompute_certify
    from s2r_spec.runs.layout import GAP, SIMULATION, SYSTEMS

    journals = (SIMULATION, *(f"{GAP}/{side}" for side in SYSTEMS))
    return SearchOptions(both, certify_report.report, recompute_certify, (SIMULATION,), journals)


certify = against(
    "",
    "Certify the worst expected robustness of the real machine: bound the simulation, bound the gap, and add both.",
    _search,
)
