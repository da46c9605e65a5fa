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

Finding: m > FLOOR as recorded whatever θ is, and without g the product of all m is smaller by CLEAR, and one broken m
is below FLOOR and CLEAR of what it was. Only recordings that break the law are compared. Of mistakes that do as well,
that with the fewest sizes and channels is the answer.

Units: m dimensionless. Source: parity relations (Gertler 1998, ch. 5; Isermann 2006, §10).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from s2r_spec.backend import HasControlLaw
from s2r_spec.diagnose.quality.comparison import CLEAR, FLOOR
from s2r_spec.diagnose.quality.finding import Finding
from s2r_spec.diagnose.quality.labels import is_able
from s2r_spec.diagnose.quality.law_family import forms
from s2r_spec.diagnose.quality.law_parity import Misfit, Mistake, Parity, alike, closeness, misfit
from s2r_spec.diagnose.quality.law_words import law_finding, misfit_words
from s2r_spec.diagnose.quality.recordings import Recordings
from s2r_spec.diagnose.simulator.bench import Test, TestRun, evenly
from s2r_spec.space import key_of

SCREENED, FITTED = 2, 6
"""Budget: recordings with which mistakes are screened, and fitted."""
LIKELY, REFINED = 8, 3
"""Budget: mistakes of the screening whose sizes are refined, and those that are fitted with the machine's sizes."""
INTERVALS = 6
"""Budget: times that the interval of a size becomes a third."""


class Found(NamedTuple):
    """A mistake with which the law holds, m as recorded and without it, and how simple it is."""

    gain: float
    mistake: Mistake
    before: Misfit
    after: Misfit
    simplicity: tuple[int, int, bool]


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
    fitted, _ = replace(every, runs=[runs[k] for k in evenly(len(runs), FITTED)]).fit()
    every = replace(every, theta=fitted.theta)
    wrong = _broken(every)
    if not wrong:
        return []
    chosen = replace(every, runs=[wrong[k] for k in evenly(len(wrong), FITTED)])
    if (label := _of_other_tests(every, wrong)) is not None:
        return [label]
    found = list(_fits(chosen))
    best = max((one.gain for one in found), default=0.0)
    near = [one for one in found if one.gain >= (1.0 - CLEAR) * best]
    return [
        law_finding(every, one.mistake, misfit_words(one.before, one.after), wrong)
        for one in sorted(near, key=lambda one: (one.simplicity, -one.gain))[:1]
    ]


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


def _fits(parity: Parity) -> Iterator[Found]:
    """Yield the mistakes with which the law holds."""
    few = replace(parity, runs=[parity.runs[k] for k in evenly(len(parity.runs), SCREENED)])
    as_recorded, every = few.errors(), parity.errors()

    def gain(mistake: Mistake) -> float:
        errors = few.errors(mistake)
        return gained(misfit(alike(as_recorded, errors)), misfit(errors))

    channels = [one for one in parity.bench.backend.channels if one.name in parity.reach]
    screened: list[tuple[float, int, Mistake]] = []
    for form in forms(channels, [trace for _, trace in parity.runs], dict(parity.reach), parity.sources):
        for group in form.groups:
            coarse = [Mistake(form, group, size) for size in form.sizes]
            coarse += [few.step(form, group)] if form.unit else []
            best = max((gain(one), -k) for k, one in enumerate(coarse))
            screened.append((best[0], len(screened), coarse[-best[1]]))
    likely = [one for better, _, one in sorted(screened, reverse=True)[:LIKELY] if better > 0.0]
    refined = sorted((_refined(few, one, gain) for one in likely), key=gain, reverse=True)
    for one in refined[:REFINED]:
        while more := one.form.grows(one.group):
            wider = max((replace(one, group=(*one.group, name)) for name in more), key=gain)
            if gain(wider) <= gain(one):
                break
            one = _refined(few, wider, gain)
        for fitted, mistake in (parity.fit(one), (parity, one)):
            assert mistake is not None
            errors = fitted.errors(mistake)
            before, after = misfit(alike(every, errors)), misfit(errors)
            if holds(before, after):
                yield Found(gained(before, after), mistake, before, after, mistake.simplicity(fitted.theta))


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
