"""What is said of a mistake that the controller's law shows: channel, mistake, size, and remedy."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from s2r_spec.diagnose.quality.comparison import CLEAR
from s2r_spec.diagnose.quality.finding import Finding, join_words, rollout_name
from s2r_spec.diagnose.quality.law_family import FORGOTTEN
from s2r_spec.diagnose.quality.law_parity import RESOLUTION, Misfit, Mistake, Parity
from s2r_spec.diagnose.simulator.bench import TestRun
from s2r_spec.trace.samples import period_of


def misfit_words(before: Misfit, after: Misfit) -> str:
    """Return how far the law is off as recorded and ``{undone}``, for the channel that shows it best."""
    name = max(before, key=lambda one: before[one])
    left = after.get(name, max(after.values()))
    less = "less than " if left <= RESOLUTION else ""
    return (
        f"as recorded, what the controller computes as {name} is off by {_part(before[name])} of its range, and by "
        f"{less}{_part(left)} {{undone}}"
    )


def _part(m: float) -> str:
    return f"{100.0 * m:.2g} %" if m < 1.0 else f"{m:.0f} times"


def is_forgotten(mistake: Mistake) -> bool:
    """Return whether a mistake is a forgotten unit."""
    return mistake.form.code == "scale" and any(abs(np.log(mistake.size / one)) < CLEAR for one in FORGOTTEN)


def law_finding(parity: Parity, mistake: Mistake, law: str, wrong: Sequence[TestRun]) -> Finding:
    """Return the finding of a mistake in some broken recordings; ``law`` is by :func:`misfit_words`."""
    group = [name for name in parity.reach if name in mistake.group]
    whole = len(group) == len(parity.reach)
    code, what, undone, remedy = _mistake_words(parity, mistake, group, whole)
    channel = "the clock" if code in ("begin", "clock") else join_words(group)
    where = "the real rollouts"
    if len(wrong) == 1 and len(parity.runs) > 1:
        number = next(k for k, (_, trace) in enumerate(parity.runs) if trace is wrong[0][1])
        where, code = rollout_name(number, wrong[0][0]), "unit of one" if code == "unit" else code
    elif len(wrong) < len(parity.runs):
        where = f"{len(wrong)} of {len(parity.runs)} real rollouts"
    words = "all channels" if whole else join_words(group)
    text = f"{words} of {where} {what}: {law.format(undone=undone)}. {remedy} in the recordings"
    return Finding(code, channel, text, certain=True)


def _mistake_words(
    parity: Parity, mistake: Mistake, group: Sequence[str], whole: bool
) -> tuple[str, str, str, str]:
    """Return code, mistake, "without it", and remedy."""
    form, size, be = mistake.form, mistake.size, "is" if len(group) == 1 else "are"
    it = "its" if len(group) == 1 else "their"
    unit = next(one.unit for one in parity.bench.backend.channels if one.name == group[0])
    match form.code:
        case "exchanged":
            return form.code, "are exchanged", "with both exchanged", "Correct the names"
        case "sign":
            has = "has" if len(group) == 1 else "have"
            return form.code, f"{has} the opposite sign", f"with {it} sign changed", "Change the sign"
        case "late" | "begin":
            ticks = abs(size) / period_of(parity.runs[0][1].times)
            late = f"{abs(size):.4g} s ({ticks:.3g} samples) {'late' if size > 0.0 else 'early'}"
            against = "the test" if whole else "the other channels"
            shift = f"Shift {it} times by {-size:.4g} s"
            return form.code, f"{be} {late} against {against}", "with shifted times", shift
        case "clock":
            fast = f"run {size:.4g} times as fast as their times say"
            return form.code, fast, "with corrected times", f"Multiply the times by {size:.4g}"
        case "scale":
            words = f"{be} {size:.4g} times what {'it' if len(group) == 1 else 'they'} should be"
            remedy = f"Divide by {size:.4g}, or write the unit that it has instead of {unit}"
            return "unit" if is_forgotten(mistake) else form.code, words, "divided by that", remedy
        case "offset":
            return form.code, f"{be} off by {size:.4g} {unit}".rstrip(), "without that", "Subtract it"
        case _:
            return form.code, f"are turned by {size:.4g} rad", "turned back", "Turn them back"
