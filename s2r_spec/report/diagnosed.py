"""A diagnosis as text."""

from __future__ import annotations

from rich.markup import escape

from s2r_spec.diagnose.diagnosis import Diagnosis, NextTest, Verdict, Which
from s2r_spec.diagnose.how_far import Gap, HowFar
from s2r_spec.diagnose.where.found import Where

COLOURS = {
    Verdict.NONE: "bold green",
    Verdict.NAMED: "bold green",
    Verdict.CONFOUNDED: "bold yellow",
    Verdict.UNKNOWN: "bold yellow",
}
SHOWN = 5
"""Ranked causes that are printed."""
WORDS = {"none": "no material effect", "unknown": "none of these"}


def markup(found: Diagnosis) -> str:
    """Return rich markup: the answer first, then what it stands on."""
    headline = f"[{COLOURS[found.verdict]}]{found.verdict.value.upper()}[/]  {escape(found.reason)}"
    return f"{headline}\n{escape(body(found))}"


def body(found: Diagnosis) -> str:
    """Return all but the first line, as plain text."""
    lines = ["", *_causes(found.which)]
    if found.where is not None:
        lines += ["", *_where(found.where)]
    if found.how_far is not None:
        lines += ["", *_shrinks(found.how_far)]
    if found.which.next_test is not None:
        lines += ["", *_next(found.which.next_test)]
    p = found.provenance
    lines += ["", *(f"  - {line}" for line in found.assumptions), ""]
    lines.append(
        f"  {p['rollouts']} real rollouts, {p['held_out']} of them held out, seed {p['seed']}, "
        f"backend {p['backend']}, model {str(p['model_hash'])[:12]}"
    )
    return "\n".join(lines)


def _causes(which: Which) -> list[str]:
    lines = [f"  {'cause':42} probability"]
    lines += [f"  {WORDS.get(names[0], ' + '.join(names)):42} {p:.3f}" for names, p in which.ranked[:SHOWN]]
    if which.estimates:
        lines += ["", "  fitted (90 % interval)"]
        for e in which.estimates:
            value = f"{e.value:.4g} {e.unit}".rstrip()
            lines.append(f"  {f'{e.effect}.{e.parameter}':42} {value}  [{e.low:.4g}, {e.high:.4g}]")
    if set(which.confounded) > set(which.answer) != set():
        lines += ["", f"  these data cannot tell apart: {', '.join(which.confounded)}"]
    return lines


def _where(where: Where) -> list[str]:
    unit = where.pair.unit
    test = ", ".join(f"{name} = {value:.3g}" for name, value in where.test.items())
    lines = [f"  where: worst of the tests that were run, {test}: Δρ {where.pair.delta:+.4f} {unit}".rstrip()]
    window = max(where.windows(), key=lambda w: abs(w["delta"]))
    if where.pair.delta:
        part = round(100 * window["delta"] / where.pair.delta)
        lines.append(f"    {part} % of it from {window['begin']:.2f} to {window['end']:.2f} s")
    credit = {name: float(values.sum()) for name, values in where.pair.credit.items()}
    if credit:
        name = max(credit, key=lambda n: abs(credit[n]))
        lines.append(f"    most of it in {name} ({credit[name]:+.4f} {unit})")
    if where.pair.switch is not None:
        lines.append(f"    {where.pair.switch}")
    return lines


def _shrinks(far: HowFar) -> list[str]:
    unit = f" in {far.unit}" if far.unit else ""
    lines = [
        f"  gap on {far.rollouts} held-out rollouts, mean |ρ_real − ρ_sim|{unit}",
        f"    before {_gap(far.before)}",
    ]
    if far.after is not None:
        lines.append(f"    after  {_gap(far.after)}")
    lines.append(f"    floor  {far.floor:.4f} (scatter alone)")
    if far.share is not None:
        value, low, high = (round(100 * part) for part in far.share)
        lines.append(f"    closed {value} % of what lies above the floor (95 %: {low} to {high} %)")
    return lines


def _next(test: NextTest) -> list[str]:
    where = ", ".join(f"{name} = {value:.3g}" for name, value in test.params.items())
    return [
        f"  next test: {where} {test.protocol}".rstrip(),
        f"    tells {' from '.join(test.separates)} by {test.sigma:.1f} σ a rollout",
    ]


def _gap(gap: Gap) -> str:
    return f"{gap.mean:.4f} (95 %: {gap.low:.4f} to {gap.high:.4f}), worst test {gap.worst:.4f}"
