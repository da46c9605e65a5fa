"""Mistakes that the controller's own law shows: exactly, and before any estimate.

Data: n recordings y_i of single channels. The simulator knows what the controller computes, u = κ_θ(y, test)
(:class:`s2r_spec.backend.HasControlLaw`), which is the same on the machine. Unknown: a mistake g of one family
(:mod:`.law_family`, and recordings of another test), and the sizes θ of the few effects that bear on κ (a sensor's
error in the controller's eyes). Model, with u among the columns of y:

    u_i = [g κ_θ(g⁻¹ y_i)] + e_i,    e_i white

Physics has no part in it: a machine with any other effect obeys its controller's law. Estimator: least squares of e in
x and θ, for each form and group of channels. The misfit of a commanded channel is what of e is not white, in parts of
its range: its autocovariance at one sample, with two standard errors of that of white noise,

    m² = (Σ e_k e_k+1 / N ± 2 Σ e_k² / N^1.5) / range²,    at least RESOLUTION²

A recording breaks the law if its m is surely above FLOOR, with θ the median over recordings. Finding: with g and θ
fitted to these, every m that changes is below FLOOR or CLEAR of what it was, one that was broken is below FLOOR, and
the product of all m is smaller by CLEAR. Of mistakes that do as well, that with the fewest sizes (also of the machine)
and channels is the answer. A test of the table, or one parameter's opposite sign, may mend the law as well (*labels*).

Units: m dimensionless. Source: parity relations (Gertler 1998, ch. 5; Isermann 2006, §10).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from s2r_spec.backend import HasControlLaw
from s2r_spec.diagnose.inference.prior import NAMED
from s2r_spec.diagnose.quality.comparison import CLEAR, FLOOR
from s2r_spec.diagnose.quality.finding import Finding, join_words, rollout_name
from s2r_spec.diagnose.quality.labels import is_able
from s2r_spec.diagnose.quality.law_family import FORGOTTEN, forms
from s2r_spec.diagnose.quality.law_parity import RESOLUTION, Misfit, Mistake, Parity, alike, closeness, misfit
from s2r_spec.diagnose.quality.recordings import Recordings
from s2r_spec.diagnose.simulator.bench import Test, TestRun, evenly
from s2r_spec.space import key_of
from s2r_spec.trace.samples import period_of

SCREENED, FITTED = 2, 6
"""Budget: recordings with which mistakes are screened, and fitted."""
LIKELY, REFINED = 2, 3
"""Budget: mistakes of each code that are refined, and of all that are fitted with the machine's sizes."""
INTERVALS = 6
"""Budget: times that the interval of a size becomes a third."""


class Found(NamedTuple):
    """A mistake with which the law holds, m as recorded and without it, its simplicity, and the recordings with it."""

    gain: float
    mistake: Mistake
    before: Misfit
    after: Misfit
    simplicity: tuple[int, int, bool]
    runs: Sequence[TestRun]


def gained(before: Misfit, after: Misfit) -> float:
    """Return the logarithm of the ratio of the products of all m; nothing is gained where a channel has none after."""
    if len(after) < len(before):
        return -np.inf
    logs = [float(np.mean([np.log(m) for m in each.values()])) if each else 0.0 for each in (before, after)]
    return (logs[0] - logs[1]) * len(before)


def holds(before: Misfit, after: Misfit) -> bool:
    """Return whether a law that is broken before holds after, wherever it is another."""
    names = [name for name, m in before.items() if after.get(name) != m]
    left = [after.get(name, max(after.values(), default=np.inf)) for name in names]
    mended = all(m <= max(FLOOR, CLEAR * before[name]) for name, m in zip(names, left, strict=True))
    broken = any(before[name] > FLOOR >= m for name, m in zip(names, left, strict=True))
    return mended and broken and gained(before, after) >= -np.log(CLEAR)


def by_law(of: Recordings) -> list[Finding]:
    """Return the mistake that the controller's law shows, if there is one."""
    runs = [run for run in of.rollouts if run[1].failure is None and len(run[1]) > 2]
    if not runs or not isinstance(of.bench.backend, HasControlLaw):
        return []
    every = Parity.of(of.bench, runs)
    if not _broken(every):
        return []
    every = _with_machine(every)
    wrong = _broken(every)
    if not wrong:
        return []
    if (label := _of_other_tests(every, wrong)) is not None:
        return [label]
    found = list(_fits(every, wrong))
    best = max((one.gain for one in found), default=0.0)
    near = [one for one in found if one.gain >= (1.0 - CLEAR) * best]
    return [
        law_finding(every, one.mistake, misfit_words(one.before, one.after), one.runs)
        for one in sorted(near, key=lambda one: (one.simplicity, -one.gain))[:1]
    ]


def _with_machine(every: Parity) -> Parity:
    """Return the recordings with the machine's sizes θ: the median of those of some recordings."""
    if not every.axes:
        return every
    some = [every.runs[k] for k in evenly(len(every.runs), FITTED)]
    sizes = [replace(every, runs=[run]).fit()[0].theta for run in some]
    return replace(every, theta=tuple(np.median(sizes, axis=0).tolist()))


def _broken(parity: Parity) -> list[TestRun]:
    """Return the recordings that break the law."""
    each = zip(parity.runs, parity.errors(), strict=True)
    return [run for run, error in each if max(misfit([error], -1.0).values(), default=0.0) > FLOOR]


def _of_other_tests(every: Parity, wrong: Sequence[TestRun]) -> Finding | None:
    """Return that the law holds at other tests than the recordings', if it does."""
    space, table = every.bench.spec.space, {key_of(test): test for test, _ in every.runs}
    pairs = [(a, b) for a, b in combinations(space.names, 2) if space.units.get(a) == space.units.get(b)]
    runs = [wrong[k] for k in evenly(len(wrong), FITTED)]

    def nearest(parity: Parity, run: TestRun) -> TestRun:
        test, trace = run
        others: list[Test] = [
            test,
            *table.values(),
            *({**test, name: -test[name] or 0.0} for name in space.names),
        ]
        others += [{**test, a: test[b], b: test[a]} for a, b in pairs]
        able = [(one, trace) for one in others if is_able(parity.bench, [one])]
        own = misfit(replace(parity, runs=[run]).errors())
        return max(able, key=lambda one: gained(own, misfit(replace(parity, runs=[one]).errors())))

    parity = replace(every, theta=(0.0,) * len(every.axes))
    for _ in range(2):  # the machine's sizes are those at the right tests
        parity = replace(parity, runs=[nearest(parity, run) for run in runs])
        parity, _ = parity.fit()
    before, after = misfit(replace(every, runs=runs).errors()), misfit(parity.errors())
    if not holds(before, after):
        return None
    text = (
        f"{len(wrong)} of {len(every.runs)} real rollouts stand under a test that is not theirs: "
        f"{misfit_words(before, after).format(undone='at another test')}. Correct the table of tests"
    )
    return Finding("labels", "the tests", text, certain=True)


def _fits(whole: Parity, wrong: Sequence[TestRun]) -> Iterator[Found]:
    """Yield the mistakes with which the law holds."""
    parity = replace(whole, runs=[wrong[k] for k in evenly(len(wrong), FITTED)])
    fine: list[tuple[Parity, Mistake]] = []
    for machine in _machines(parity):
        few = replace(machine, runs=[parity.runs[k] for k in evenly(len(parity.runs), SCREENED)])
        gain = _gain(few)
        refined = sorted((_refined(few, one, gain) for one in _likely(few, gain)), key=gain, reverse=True)
        fine += [(few, _grown(few, one, gain)) for one in refined[:REFINED]]
    every = parity.errors()
    for few, grown in fine:
        machine = replace(few, runs=parity.runs)
        for fitted, best in (machine.fit(grown), (machine, grown)):
            one = best or grown
            errors = fitted.errors(one)
            before, after = misfit(alike(every, errors)), misfit(errors)
            if abs(one.size) < one.form.least or not holds(before, after):
                continue
            if runs := _sharing(fitted, whole, wrong, one):
                yield Found(gained(before, after), one, before, after, one.simplicity(fitted.theta), runs)


def _machines(parity: Parity) -> list[Parity]:
    """Return the recordings with the machine's sizes, and with none, for a mistake may look like a sensor's error."""
    far = max(map(abs, parity.theta), default=0.0) >= NAMED
    return [parity, replace(parity, theta=(0.0,) * len(parity.axes))] if far else [parity]


def _gain(parity: Parity) -> Callable[[Mistake], float]:
    start = parity.errors()

    def gain(mistake: Mistake) -> float:
        errors = parity.errors(mistake)
        return gained(misfit(alike(start, errors)), misfit(errors))

    return gain


def _likely(few: Parity, gain: Callable[[Mistake], float]) -> list[Mistake]:
    """Return the mistakes of each code with which the law is broken least."""
    channels = [one for one in few.bench.backend.channels if one.name in few.reach]
    screened: dict[str, list[tuple[float, int, Mistake]]] = {}
    for number, form in enumerate(
        forms(channels, [trace for _, trace in few.runs], dict(few.reach), few.sources)
    ):
        for group in form.groups:
            coarse = [Mistake(form, group, size) for size in form.sizes]
            coarse += [few.step(form, group)] if form.unit else []
            gains = [gain(one) for one in coarse]
            best = int(np.argmax(gains))
            screened.setdefault(form.code, []).append((gains[best], -number, coarse[best]))
    ordered = [sorted(each, key=lambda one: one[:2], reverse=True)[:LIKELY] for each in screened.values()]
    return [one for each in ordered for better, _, one in each if better > 0.0]


def _grown(few: Parity, mistake: Mistake, gain: Callable[[Mistake], float]) -> Mistake:
    """Return a mistake of a larger group, as long as a further channel breaks the law less."""
    while more := mistake.form.grows(mistake.group):
        wider = max((replace(mistake, group=(*mistake.group, name)) for name in more), key=gain)
        if gain(wider) <= gain(mistake):
            break
        mistake = _refined(few, wider, gain)
    return mistake


def _sharing(fitted: Parity, whole: Parity, wrong: Sequence[TestRun], mistake: Mistake) -> Sequence[TestRun]:
    """Return which recordings have a mistake: all if the others gain, too, or those that break the law, or none.

    A size is that of an instrument or of a clock, which all recordings share. Names, signs and units may be a file's.
    """
    others = replace(fitted, runs=[run for run in whole.runs if all(run is not one for one in wrong)])
    if not others.runs:
        return whole.runs
    errors = others.errors(mistake)
    if gained(misfit(alike(others.errors(), errors)), misfit(errors)) > 0.0:
        return whole.runs
    return wrong if not mistake.form.unit or is_forgotten(mistake) else ()


def _refined(parity: Parity, mistake: Mistake, gain: Callable[[Mistake], float]) -> Mistake:
    """Return a mistake with the best size: by least squares, or where samples are read between others by intervals."""
    form, sizes = mistake.form, list(mistake.form.sizes)
    if not form.unit:
        return mistake
    if not form.resampled:
        return max((one for one in (mistake, parity.fit(mistake, machine=False)[1]) if one), key=gain)
    k = int(np.argmin(np.abs(np.array(sizes) - mistake.size)))
    low, high = sizes[max(k - 1, 0)], sizes[min(k + 1, len(sizes) - 1)]
    for _ in range(INTERVALS):
        tried = [replace(mistake, size=float(size)) for size in (mistake.size, *np.linspace(low, high, 7))]
        mistake = max(tried, key=lambda one: (round(gain(one), 1), closeness(parity.errors(one))))
        low, high = mistake.size - (high - low) / 6.0, mistake.size + (high - low) / 6.0
    return mistake


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
