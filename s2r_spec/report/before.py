"""What runs would say about every effect, before the data, as text."""

from __future__ import annotations

from s2r_spec.base.printable import one_line
from s2r_spec.base.quantity import Scale, quantity
from s2r_spec.diagnose.before import RUNS, BeforeData, Foreseen, Identified
from s2r_spec.report.gap_words import join_names


def text(found: BeforeData) -> str:
    """Return plain text: the plan, and a table for the effects of each status."""
    lines = [
        f"before the data: what {RUNS} runs each of {join_names(found.plan)} would say ({found.backend})",
        "  of each effect alone at its typical size, on a machine that scatters as the simulator does",
    ]
    heads = {
        Identified.ALONE: "by this alone",
        Identified.TOGETHER: "not separated from",
        Identified.UNSEEN: "a further run that shows it",
    }
    for status, last in heads.items():
        if own := [one for one in found.effects if one.status is status]:
            rows = [(status.value, "typical", "± (90 %)", "", last), *map(_row, own)]
            lines += ["", *("  {:30} {:16} {:16} {:5} {}".format(*row).rstrip() for row in rows)]
    return "\n".join(map(one_line, lines))


def _row(one: Foreseen) -> tuple[str, str, str, str, str]:
    unit, size, (low, high) = one.axis.unit, one.axis.at_typical(), one.interval
    scale, half = Scale.of(size, unit), (high - low) / 2.0
    run = one.run or ("all of them" if one.status is Identified.ALONE else "none")
    if one.status is Identified.TOGETHER:
        run = join_names(one.rivals) + (f"; {one.run} would tell" if one.run else "; no further run would")
    if one.status is Identified.UNSEEN:
        return one.axis.name, quantity(size, unit), "", "", run
    width = f"{scale.number(half, half)} {scale.unit}".rstrip()
    return one.axis.name, quantity(size, unit), width, f"{100.0 * one.half_width:.0f} %", run
