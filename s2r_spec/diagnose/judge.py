"""The judge: evidence and trained networks, weighed against each other by fixed numbers."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.catalogue import Catalogue
from s2r_spec.diagnose.evidence import Evidence, Linear, Set, believed, evidence, solved
from s2r_spec.diagnose.layout import Layout
from s2r_spec.diagnose.logs import logsumexp
from s2r_spec.diagnose.models import Surrogate
from s2r_spec.diagnose.practice import KINDS, Case, Practice
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
HIDDEN = (256, 128)
NETWORKS = 3
"""That vote, by the mean of their log odds."""
TREES = 300
FUNCTIONS = 3
"""Functions of the test that the network sees."""
FALSE_ALARMS = 0.05
"""Known effects that may be called unknown."""
PRIOR_UNKNOWN = 0.15


@dataclass(frozen=True)
class Weights:
    """How evidence and networks are weighed against each other.

    On practice cases the networks are at home and the evidence is not needed; on a machine it is the other
    way round. So these come from twins by other code, made for development and never used for a score
    (``benchmarks/blind/weigh.py``), and are the same for every backend. That code also makes the sealed sets, with
    other seeds.

    A set A of effects scores evidence · log evidence / temperature + trust · log P_network(A) − penalty[|A|], the
    penalty being that of a catalogue of ``catalogue`` effects; see :meth:`penalties`. Where the
    equations of motion are asked by themselves (:mod:`s2r_spec.diagnose.told`) it is told · their log evidence more,
    and the networks are trusted by ``beside`` alone. Of traces that look like nothing they practised on they know
    little: either trust is times P(the cause is in the catalogue), by the traces. The features hang together: n of
    them, each seen through a few functions of the test, count as ``independent`` ones, and the temperature is n /
    independent, where the joint fit leaves what is usual of the data; where the simulator is nearer to the truth than
    that, it is less, as the root of what is left.
    """

    independent: float
    evidence: float
    trust: float
    penalty: tuple[float, float, float, float]
    told: float
    beside: float
    catalogue: int

    def penalties(self, size: NDArray[np.int64], effects: int, trust: float | None) -> FloatArray:
        """Return what sets of so many effects lose.

        Beyond the last of ``penalty`` each effect costs as much as that did. In a larger catalogue there are more sets
        of a size, and each is so much less likely. Networks know on how many effects they practised, and say so as far
        as they are trusted; where they abstain, it is said of no effect at all, too.

        Args:
            size: of each set.
            effects: in the catalogue.
            trust: in the networks; None where they abstain.
        """
        known = np.array(self.penalty)
        beyond = np.maximum(size - (len(known) - 1), 0)
        found: FloatArray = known[np.minimum(size, len(known) - 1)] + beyond * (known[-1] - known[-2])
        more = _sets_of(size, effects) - _sets_of(size, self.catalogue)
        nothing = 0.0 if trust is not None else -float(np.log(effects * KINDS[0] / KINDS[1]))
        return np.where(size > 0, found + (1.0 - (trust or 0.0)) * more, nothing)


WEIGHTS = Weights(50.0, 2.0, 0.57, (0.0, 0.0, 2.9, 4.3), 0.6, 0.4, 12)
USUAL = 0.1
"""Misfit of the joint fit, in units of what is believed, for which ``independent`` is meant."""
COLDEST = 1.0
"""Least temperature."""


@dataclass(frozen=True)
class Sets:
    """Sets of effects with a probability each; they sum to 1."""

    members: tuple[Set, ...]
    probability: FloatArray

    def ranked(self) -> list[tuple[tuple[int, ...], float]]:
        """Return the sets, most probable first."""
        order = np.argsort(-self.probability)
        return [(self.members[i], float(self.probability[i])) for i in order]


@dataclass(frozen=True)
class Judge:
    """Everything learnt from practice cases.

    Attributes:
        effects: names, in the order of the places used everywhere.
        networks: P(effect k is in the set), each.
        weights: see there.
        stranger: P(the cause is not in the catalogue).
        threshold: of that, above which an alarm is given.
        practice: how it did on practice cases that the networks did not see.
    """

    effects: tuple[str, ...]
    networks: tuple[Any, ...]
    weights: Weights
    stranger: Any
    threshold: float
    practice: dict[str, float]

    def memberships(self, description: FloatArray) -> FloatArray:
        """Return (n, K) probabilities that an effect is among the causes, by the network alone."""
        return _voted(self.networks, description)

    def sets(
        self,
        found: Evidence,
        p: FloatArray | None,
        temperature: float,
        unknown: float,
        told: FloatArray | None = None,
    ) -> Sets:
        """Return the probability of every set, given that the catalogue has the causes.

        Args:
            found: evidence.
            p: (K,) votes of the networks; None if they abstain.
            temperature: by which log evidence is divided.
            unknown: probability that the cause is not in the catalogue, by the traces; see :class:`Weights`.
            told: (sets,) log evidence by the equations, if they are asked.
        """
        w = self.weights
        trust = (w.trust if told is None else w.beside) * (1.0 - unknown)
        score = _score(found.members, found.logs, p, w, temperature, trust, len(self.effects))
        if told is not None:
            score = score + w.told * told
        return Sets(found.members, np.exp(score - logsumexp(score)))

    def unknown(self, found: Evidence, p: FloatArray | None) -> float:
        """Return the probability that the cause is not in the catalogue, by the traces alone; ``p`` as above."""
        if p is None:
            p = np.full(len(self.effects), 0.5)
        return float(self.stranger.predict_proba(_strangeness(found, p)[None])[0, 1])


def describe(coefficients: FloatArray) -> FloatArray:
    """Return what the network sees of coefficients (q, k): a few functions of the test, large values eased."""
    seen = np.zeros((FUNCTIONS, coefficients.shape[1]))
    rows = coefficients[:FUNCTIONS]
    seen[: len(rows)] = np.arcsinh(rows / 2.0)
    return seen.ravel()


def _voted(networks: Sequence[Any], description: FloatArray) -> FloatArray:
    """Return (n, K): the mean of the networks, by log odds."""
    # Of a single effect scikit-learn gives both, that it is absent and that it is there.
    told = [network.predict_proba(description) for network in networks]
    p = np.clip(
        [
            t[:, 1:] if network.n_outputs_ == 1 and t.shape[1] == 2 else t
            for network, t in zip(networks, told, strict=True)
        ],
        1e-4,
        1.0 - 1e-4,
    )
    odds = np.log(p / (1.0 - p)).mean(axis=0)
    found: FloatArray = 1.0 / (1.0 + np.exp(-odds))
    return found


def _strangeness(found: Evidence, p: FloatArray) -> FloatArray:
    """Return what the detector of unknown causes sees."""
    none, one, two, three = (found.best(size) for size in range(4))
    energy = max(found.energy, 1e-9)
    singles = sorted((v for s, v in zip(found.members, found.logs, strict=True) if len(s) == 1), reverse=True)
    ordered = np.sort(p)[::-1]
    return np.array(
        [
            np.log(energy),
            *found.left,
            *np.log(energy * np.maximum(found.left, 1e-9)),
            *np.log(found.pull + 1e-3),
            np.arcsinh(one - none) if np.isfinite(one) else 0.0,
            np.arcsinh(two - one) if np.isfinite(two) else 0.0,
            np.arcsinh(three - two) if np.isfinite(three) else 0.0,
            np.arcsinh(singles[0] - singles[1]) if len(singles) > 1 else 0.0,
            ordered[0],
            ordered[1] if len(p) > 1 else 0.0,
            float(p.sum()),
        ]
    )


def temperature(count: float, misfit: float, weights: Weights) -> float:
    """Return by what log evidence is divided before it is believed; see :class:`Weights`.

    Args:
        count: numbers that it is from.
        misfit: of the joint fit.
        weights: see there.
    """
    return max(count / weights.independent * float(np.sqrt(min(misfit / USUAL, 1.0))), COLDEST)


def _sets_of(size: NDArray[np.int64], effects: int) -> FloatArray:
    """Return the logarithm of how many sets there are of a size, for every single effect."""
    from scipy.special import gammaln

    return np.asarray(
        gammaln(effects + 1.0) - gammaln(size + 1.0) - gammaln(effects - size + 1.0) - np.log(effects)
    )


def _score(
    members: tuple[tuple[int, ...], ...],
    logs: FloatArray,
    p: FloatArray | None,
    w: Weights,
    temperature: float,
    trust: float,
    effects: int,
) -> FloatArray:
    score: FloatArray = w.evidence * (logs - logs.max()) / temperature
    if p is None:
        return score - w.penalties(np.array([len(a) for a in members]), effects, None)
    vote, size = votes(members, p)
    return score + trust * vote - w.penalties(size, effects, trust)


def votes(members: tuple[tuple[int, ...], ...], p: FloatArray) -> tuple[FloatArray, NDArray[np.int64]]:
    """Return log P(set) of independent memberships, up to a constant, and the sets' sizes."""
    p = np.clip(p, 0.005, 0.995)
    odds = np.log(p / (1.0 - p))
    return np.array([sum(odds[k] for k in a) for a in members]), np.array([len(a) for a in members])


@dataclass(frozen=True)
class _Solved:
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
    from sklearn.ensemble import ExtraTreesClassifier
    from sklearn.neural_network import MLPClassifier

    rng = np.random.default_rng(seed)
    known = signatures.bank.tests
    practice = Practice(signatures)
    effects = practice.effects
    cases, judged = CASES * len(effects), JUDGED * len(effects)
    strange_ones, absent = round(STRANGE * judged), round(ABSENT * judged)

    def tests() -> list[dict[str, float]]:
        count = int(rng.choice([10, 14, 20, 30]))
        distinct = [space.point(p) for p in space.at(rng.uniform(size=(count, space.dim)))]
        again = rng.permutation(count)[: count // 3]
        return distinct + [distinct[int(i)] for i in again for _ in range(2)]

    layouts = [Layout.of(space, known, tests()) for _ in range(16)]
    x = np.zeros((cases, FUNCTIONS * signatures.size))
    y = np.zeros((cases, len(effects)), dtype=int)
    for i in range(cases):
        case = practice.draw(rng, layouts[i % len(layouts)])
        x[i] = describe(case.coefficients)
        y[i, list(case.effects)] = 1
        if progress is not None and i % 500 == 0:
            progress(i, 2 * cases)
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

    catalogue = Catalogue.of(signatures.curves)
    desks = [_Desk.of(signatures, catalogue, layout) for layout in layouts[:6]]
    solved: list[_Solved] = []
    for i in range(judged + strange_ones):
        desk = desks[i % len(desks)]
        solved.append(_solve(rng, signatures, desk, practice, networks, stranger=i >= judged))
        if progress is not None and i % 50 == 0:
            progress(cases + cases * i // (judged + strange_ones + absent), 2 * cases)
    usual, strangers = solved[:judged], solved[judged:]
    weights = WEIGHTS

    strange = [_strangeness(s.found, s.p) for s in solved]
    label = [0] * judged + [1] * len(strangers)
    able = [i for i, s in enumerate(usual) if s.case.effects and s.size > 1.0]
    for i in rng.permutation(able)[:absent]:
        s = usual[i]
        gone = int(rng.choice(s.case.effects))
        q = s.p.copy()
        q[gone] = 0.0
        strange.append(_strangeness(evidence(s.data, without=gone), q))
        label.append(1)
    s_x, s_y = np.array(strange), np.array(label)
    weight = np.where(s_y == 1, PRIOR_UNKNOWN / (s_y == 1).mean(), (1 - PRIOR_UNKNOWN) / (s_y == 0).mean())

    def detector() -> Any:
        return ExtraTreesClassifier(TREES, min_samples_leaf=4, max_features=None, random_state=seed, n_jobs=1)

    # Each half is judged by trees that saw the other: the threshold never sees a vote on a seen case.
    out = np.zeros(len(s_y))
    fold = rng.permutation(len(s_y)) % 2 == 0
    for part in (fold, ~fold):
        fitted = detector().fit(s_x[~part], s_y[~part], sample_weight=weight[~part])
        out[part] = fitted.predict_proba(s_x[part])[:, 1]
    threshold = float(np.quantile(out[s_y == 0], 1.0 - FALSE_ALARMS))
    return Judge(
        effects,
        networks,
        weights,
        detector().fit(s_x, s_y, sample_weight=weight),
        threshold,
        _practice(usual, weights, out, s_y, threshold),
    )


def _solve(
    rng: np.random.Generator,
    signatures: Signatures,
    desk: _Desk,
    practice: Practice,
    networks: Sequence[Any],
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
    p = _voted(networks, describe(z)[None])[0]
    size = float(np.sqrt((case.alone**2 / believed(scatter)).mean()))
    return _Solved(case, size, data, evidence(data), p, fitted.misfit)


def _practice(
    solved: Sequence[_Solved], weights: Weights, out: FloatArray, label: NDArray[Any], threshold: float
) -> dict[str, float]:
    """Return how often practice cases that the network did not see were answered rightly."""
    hits: dict[str, list[bool]] = {"single": [], "pair": [], "triple": [], "none": [], "sure": []}
    for s in solved:
        score = _score(
            s.found.members,
            s.found.logs,
            s.p,
            weights,
            temperature(s.data.size, s.misfit, weights),
            weights.trust,
            len(s.p),
        )
        first = int(np.argmax(score))
        right = s.found.members[first] == s.case.effects
        kind = ("none", "single", "pair", "triple")[len(s.case.effects)]
        if kind == "none" or s.size > 2.0:
            hits[kind].append(right)
        if np.exp(score[first] - logsumexp(score)) >= 0.9:
            hits["sure"].append(right)
    rates = {name: float(np.mean(values)) for name, values in hits.items() if values}
    return rates | {
        "unknown detected": float((out[label == 1] > threshold).mean()),
        "sure share": len(hits["sure"]) / len(solved),
    }
