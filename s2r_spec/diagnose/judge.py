"""The judge: evidence and trained networks, weighed against each other by fixed numbers."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.classifiers import Forest, Network
from s2r_spec.diagnose.evidence import Evidence, Set
from s2r_spec.diagnose.logs import logsumexp
from s2r_spec.diagnose.practice import KINDS

FloatArray = NDArray[np.float64]

FUNCTIONS = 3
"""Functions of the test that the network sees."""


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
    networks: tuple[Network, ...]
    weights: Weights
    stranger: Forest
    threshold: float
    practice: dict[str, float]

    def memberships(self, description: FloatArray) -> FloatArray:
        """Return (n, K) probabilities that an effect is among the causes, by the network alone."""
        return voted(self.networks, description)

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
        scores = score(found.members, found.logs, p, w, temperature, trust, len(self.effects))
        if told is not None:
            scores = scores + w.told * told
        return Sets(found.members, np.exp(scores - logsumexp(scores)))

    def unknown(self, found: Evidence, p: FloatArray | None) -> float:
        """Return the probability that the cause is not in the catalogue, by the traces alone; ``p`` as above."""
        if p is None:
            p = np.full(len(self.effects), 0.5)
        return float(self.stranger.probabilities(strangeness(found, p)[None])[0])


def describe(coefficients: FloatArray) -> FloatArray:
    """Return what the network sees of coefficients (q, k): a few functions of the test, large values eased."""
    seen = np.zeros((FUNCTIONS, coefficients.shape[1]))
    rows = coefficients[:FUNCTIONS]
    seen[: len(rows)] = np.arcsinh(rows / 2.0)
    return seen.ravel()


def voted(networks: Sequence[Network], description: FloatArray) -> FloatArray:
    """Return (n, K): the mean of the networks, by log odds."""
    p = np.clip([network.probabilities(description) for network in networks], 1e-4, 1.0 - 1e-4)
    odds = np.log(p / (1.0 - p)).mean(axis=0)
    found: FloatArray = 1.0 / (1.0 + np.exp(-odds))
    return found


def strangeness(found: Evidence, p: FloatArray) -> FloatArray:
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


def score(
    members: tuple[tuple[int, ...], ...],
    logs: FloatArray,
    p: FloatArray | None,
    w: Weights,
    temperature: float,
    trust: float,
    effects: int,
) -> FloatArray:
    """Return (sets,) what each scores, up to a constant; see :class:`Weights`. ``effects`` are in the catalogue."""
    found: FloatArray = w.evidence * (logs - logs.max()) / temperature
    if p is None:
        return found - w.penalties(np.array([len(a) for a in members]), effects, None)
    vote, size = votes(members, p)
    return found + trust * vote - w.penalties(size, effects, trust)


def votes(members: tuple[tuple[int, ...], ...], p: FloatArray) -> tuple[FloatArray, NDArray[np.int64]]:
    """Return log P(set) of independent memberships, up to a constant, and the sets' sizes."""
    p = np.clip(p, 0.005, 0.995)
    odds = np.log(p / (1.0 - p))
    return np.array([sum(odds[k] for k in a) for a in members]), np.array([len(a) for a in members])


def save(made: Judge, path: Path) -> None:
    """Write a judge as one NPZ file: arrays, and JSON for the rest."""
    text = json.dumps(
        {
            "effects": made.effects,
            "weights": asdict(made.weights),
            "threshold": made.threshold,
            "practice": made.practice,
            "layers": [len(network.weights) for network in made.networks],
        }
    )
    arrays = {f"forest.{name}": values for name, values in vars(made.stranger).items()}
    for n, network in enumerate(made.networks):
        for layer, (weight, bias) in enumerate(zip(network.weights, network.biases, strict=True)):
            arrays |= {f"network{n}.weights{layer}": weight, f"network{n}.biases{layer}": bias}
    np.savez(path, text=np.array(text), **arrays)


def load(path: Path) -> Judge:
    """Read what :func:`save` wrote.

    Raises:
        ValueError: it is something else; other errors where it is no archive, or lacks parts.
    """
    with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
        text = json.loads(str(arrays["text"]))
        networks = tuple(
            Network(
                tuple(arrays[f"network{n}.weights{layer}"] for layer in range(layers)),
                tuple(arrays[f"network{n}.biases{layer}"] for layer in range(layers)),
            )
            for n, layers in enumerate(text["layers"])
        )
        forest = Forest(**{name: arrays[f"forest.{name}"] for name in Forest.__dataclass_fields__})
    effects, weights = tuple(text["effects"]), text["weights"]
    if any(network.biases[-1].shape != (len(effects),) for network in networks):
        raise ValueError("the networks know other effects than the judge")
    return Judge(
        effects,
        networks,
        Weights(**(weights | {"penalty": tuple(weights["penalty"])})),
        forest,
        float(text["threshold"]),
        {name: float(value) for name, value in text["practice"].items()},
    )
