"""How a judge is made: networks and a detector of unknown causes learn from practice cases alone."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.catalogue import Catalogue
from s2r_spec.diagnose.classifiers import Forest, Network
from s2r_spec.diagnose.evidence import Evidence, Linear, believed, evidence, solved
from s2r_spec.diagnose.judge import (
    FUNCTIONS,
    WEIGHTS,
    Judge,
    Weights,
    describe,
    score,
    strangeness,
    temperature,
    voted,
)
from s2r_spec.diagnose.layout import Layout
from s2r_spec.diagnose.logs import logsumexp
from s2r_spec.diagnose.models import Surrogate
from s2r_spec.diagnose.practice import Case, Practice
from s2r_spec.diagnose.signatures import Signatures
from s2r_spec.space import Space

FloatArray = NDArray[np.float64]

CASES = 400
"""Practice cases that the network learns from, per effect of the catalogue."""
JUDGED = 35
"""Further ones per effect, on which the detector of unknown causes learns, and on which is told how the rest did."""
ABSENT = 0.6
"""Part of these that is judged again with a true effect taken out of the catalogue."""
STRANGE = 0.3
"""As many more, as a part of these, are of an effect that no line has."""
LAYOUTS, DESKS = 16, 6
"""Sets of tests at which cases are drawn, and of these those at which some are also solved."""
HIDDEN = (256, 128)
NETWORKS = 3
"""That vote, by the mean of their log odds."""
TREES = 300
FALSE_ALARMS = 0.05
"""Known effects that may be called unknown."""
PRIOR_UNKNOWN = 0.15


@dataclass(frozen=True)
class _Solved:
    """A practice case, and what the evidence and the networks make of it.

    Attributes:
        case: drawn.
        size: of what its effects do, in units of what is believed.
        data: around the fit of the whole catalogue.
        found: evidence.
        p: (K,) votes of the networks.
        misfit: of the fit.
    """

    case: Case
    size: float
    data: Linear
    found: Evidence
    p: FloatArray
    misfit: float


@dataclass(frozen=True)
class _Desk:
    """A layout with everything that solving cases of it needs."""

    layout: Layout
    surrogate: Surrogate
    nuisances: FloatArray

    @classmethod
    def of(cls, signatures: Signatures, catalogue: Catalogue, layout: Layout) -> _Desk:
        nuisances = np.einsum("qm,vmk->vqk", layout.through, signatures.numerics)
        return cls(layout, Surrogate(catalogue, layout.through), nuisances)


def train(
    signatures: Signatures,
    space: Space,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Judge:
    """Learn from practice cases alone; see :mod:`s2r_spec.diagnose.practice`."""
    rng = np.random.default_rng(seed)
    practice = Practice(signatures)
    count = len(practice.effects)
    layouts = [Layout.of(space, signatures.bank.tests, _tests(rng, space)) for _ in range(LAYOUTS)]
    cases, judged = CASES * count, JUDGED * count
    strange = round(STRANGE * judged)
    tell = progress or (lambda done, of: None)

    x = np.zeros((cases, FUNCTIONS * signatures.size))
    y = np.zeros((cases, count), dtype=int)
    for i in range(cases):
        case = practice.draw(rng, layouts[i % len(layouts)])
        x[i] = describe(case.coefficients)
        y[i, list(case.effects)] = 1
        if i % 500 == 0:
            tell(i, 2 * cases)
    tell(cases, 2 * cases)
    networks = _networks(x, y, seed)

    catalogue = Catalogue.of(signatures.curves)
    desks = [_Desk.of(signatures, catalogue, layout) for layout in layouts[:DESKS]]
    every: list[_Solved] = []
    for i in range(judged + strange):
        desk = desks[i % len(desks)]
        every.append(_solve(rng, signatures, desk, practice, networks, stranger=i >= judged))
        if i % 50 == 0:
            tell(cases + cases * i // (judged + strange), 2 * cases)
    stranger, threshold, seen = _detector(rng, every[:judged], every[judged:], seed)
    practised = _practised(every[:judged], WEIGHTS) | {"unknown detected": seen}
    return Judge(practice.effects, networks, WEIGHTS, stranger, threshold, practised)


def _tests(rng: np.random.Generator, space: Space) -> list[dict[str, float]]:
    """Return tests as somebody might run them, a third of them three times."""
    count = int(rng.choice([10, 14, 20, 30]))
    distinct = [space.point(p) for p in space.at(rng.uniform(size=(count, space.dim)))]
    again = rng.permutation(count)[: count // 3]
    return distinct + [distinct[int(i)] for i in again for _ in range(2)]


def _networks(x: FloatArray, y: NDArray[Any], seed: int) -> tuple[Network, ...]:
    """Return networks that learnt which effects (n, K) are in descriptions (n, d)."""
    from sklearn.neural_network import MLPClassifier

    networks = tuple(
        MLPClassifier(
            HIDDEN,
            alpha=1e-2,
            batch_size=128,
            early_stopping=True,
            n_iter_no_change=4,
            max_iter=40,
            random_state=seed + number,
        )
        for number in range(NETWORKS)
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that it was still improving when it was stopped
        for network in networks:
            network.fit(x, y)
    return tuple(Network.of(network) for network in networks)


def _solve(
    rng: np.random.Generator,
    signatures: Signatures,
    desk: _Desk,
    practice: Practice,
    networks: Sequence[Network],
    stranger: bool,
) -> _Solved:
    case = practice.draw(rng, desk.layout, stranger)
    surrogate = desk.surrogate
    z = case.coefficients
    own = np.diag(signatures.noise)
    scatter = desk.layout.variance(own, own)
    variance = believed(scatter, desk.layout.level(z))
    begin = surrogate.turned(z, variance)
    fitted, data, _ = solved(
        surrogate, surrogate.catalogue, z, variance, desk.nuisances, begin, surrogate.jacobian(begin)
    )
    p = voted(networks, describe(z)[None])[0]
    size = float(np.sqrt((case.alone**2 / believed(scatter)).mean()))
    return _Solved(case, size, data, evidence(data), p, fitted.misfit)


def _detector(
    rng: np.random.Generator, usual: Sequence[_Solved], strangers: Sequence[_Solved], seed: int
) -> tuple[Forest, float, float]:
    """Return a detector of causes that the catalogue lacks, its threshold, and what part of these it sees.

    It learns from cases of effects that no line has, and from others with one of their effects taken out.
    """
    from sklearn.ensemble import ExtraTreesClassifier

    x = [strangeness(s.found, s.p) for s in (*usual, *strangers)]
    y = [0] * len(usual) + [1] * len(strangers)
    able = [i for i, s in enumerate(usual) if s.case.effects and s.size > 1.0]
    for i in rng.permutation(able)[: round(ABSENT * len(usual))]:
        s = usual[i]
        gone = int(rng.choice(s.case.effects))
        q = s.p.copy()
        q[gone] = 0.0
        x.append(strangeness(evidence(s.data, without=gone), q))
        y.append(1)
    rows, label = np.array(x), np.array(y)
    rare = PRIOR_UNKNOWN / (label == 1).mean()
    weight = np.where(label == 1, rare, (1 - PRIOR_UNKNOWN) / (label == 0).mean())

    def fitted(which: NDArray[np.bool_]) -> Forest:
        trees = ExtraTreesClassifier(
            TREES, min_samples_leaf=4, max_features=None, random_state=seed, n_jobs=1
        )
        return Forest.of(trees.fit(rows[which], label[which], sample_weight=weight[which]))

    # Each half is judged by trees that saw the other: the threshold never sees a vote on a seen case.
    out = np.zeros(len(label))
    fold = rng.permutation(len(label)) % 2 == 0
    for part in (fold, ~fold):
        out[part] = fitted(~part).probabilities(rows[part])
    threshold = float(np.quantile(out[label == 0], 1.0 - FALSE_ALARMS))
    return fitted(np.ones_like(fold)), threshold, float((out[label == 1] > threshold).mean())


def _practised(solved: Sequence[_Solved], weights: Weights) -> dict[str, float]:
    """Return how often practice cases that the network did not see were answered rightly."""
    hits: dict[str, list[bool]] = {"single": [], "pair": [], "triple": [], "none": [], "sure": []}
    for s in solved:
        scores = score(
            s.found.members,
            s.found.logs,
            s.p,
            weights,
            temperature(s.data.size, s.misfit, weights),
            weights.trust,
            len(s.p),
        )
        first = int(np.argmax(scores))
        right = s.found.members[first] == s.case.effects
        kind = ("none", "single", "pair", "triple")[len(s.case.effects)]
        if kind == "none" or s.size > 2.0:
            hits[kind].append(right)
        if np.exp(scores[first] - logsumexp(scores)) >= 0.9:
            hits["sure"].append(right)
    rates = {name: float(np.mean(values)) for name, values in hits.items() if values}
    return rates | {"sure share": len(hits["sure"]) / len(solved)}
