"""``s2r certify``: bound the real machine's worst case by the simulation's bound plus the gap's."""

from __future__ import annotations

from s2r_spec.cli.options.against import Search, against


def _search() -> Search:
    from s2r_spec.certify.real_machine import certify as both
    from s2r_spec.runs.layout import GAP, SIMULATION, SYSTEMS

    return both, (SIMULATION,), (SIMULATION, *(f"{GAP}/{side}" for side in SYSTEMS))


certify = against(
    "",
    "Certify the worst expected robustness of the real machine: bound the simulation, bound the gap, and add both.",
    _search,
)
