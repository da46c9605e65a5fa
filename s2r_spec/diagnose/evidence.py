"""How well each set of effects explains the data: Gaussian evidence with a background and a form error.

    z = Σ_{k∈A} μ_k(θ_k) + J β + δ + ε

z are the components of real minus nominal, projected on functions of the test;
β ~ N(0, 0.05²) says that everything in the catalogue is slightly wrong, δ ~ N(0, η²)
that the law of an effect is another than ours, ε is scatter. η and θ are summed
over grids; all else is Gaussian, so that every set of one or two effects is
scored exactly from the Gram matrix of the signatures.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.design import basis, weights
from s2r_spec.diagnose.logs import logsumexp
from s2r_spec.diagnose.signatures import Signatures

FloatArray = NDArray[np.float64]

BACKGROUND = 0.05
LEVELS = 6
"""Form errors η that are summed over, each twice the one before; the last is about the rms size of the data."""
GROUND = 0.3
"""Form error that is always there, in units of the features' scale: numerics that differ."""


@dataclass(frozen=True)
class Candidates:
    """Every point of every line, as a signature in this design.

    Attributes:
        mu: (c, D) signatures.
        line: (c,) place of its line.
        effect: (c,) place of its effect in ``effects``.
        coordinate: (c,) along its line.
        effects: names.
    """

    mu: FloatArray
    line: NDArray[np.int64]
    effect: NDArray[np.int64]
    coordinate: FloatArray
    effects: tuple[str, ...]

    @property
    def starts(self) -> NDArray[np.int64]:
        """(K,) place of each effect's first candidate."""
        return np.searchsorted(self.effect, np.arange(len(self.effects)))


@dataclass(frozen=True)
class Layout:
    """What follows from where the real tests lie.

    Attributes:
        project: (q, n) from rollouts to functions of the test.
        interpolate: (n, m) from the bank's tests to these.
        through: (q, m) from the bank's tests to functions of the test.
        scatter: (q, q) covariance of the functions' coefficients, in units of one rollout's scatter.
    """

    project: FloatArray
    interpolate: FloatArray
    through: FloatArray
    scatter: FloatArray

    @classmethod
    def of(
        cls, signatures: Signatures, known: FloatArray, points: FloatArray, inflation: float = 1.0
    ) -> Layout:
        """Lay out tests at ``points`` (n, dim) in the unit box; ``known`` (m, dim) are the bank's."""
        b = _basis(points)
        project = np.asarray(np.linalg.pinv(b), dtype=np.float64)
        interpolate = weights(known, points)
        shots = signatures.bank.nominal.shape[0] * signatures.bank.nominal.shape[1]
        scatter = inflation * np.linalg.inv(b.T @ b) + project @ project.T * (len(points) / shots)
        return cls(project, interpolate, project @ interpolate, scatter)

    @property
    def root(self) -> FloatArray:
        """(q, q) Cholesky factor of ``scatter``."""
        return np.asarray(np.linalg.cholesky(self.scatter), dtype=np.float64)


@dataclass(frozen=True)
class Design:
    """Tests at which real rollouts were made, and what follows from them alone.

    Attributes:
        layout: see there.
        candidates: see there.
        spectrum: (D,) eigenvalues of scatter, background and numerics together.
        rotate: (D, D) their eigenvectors, as rows.
    """

    signatures: Signatures
    layout: Layout
    candidates: Candidates
    spectrum: FloatArray
    rotate: FloatArray
    levels: dict[int, Level] = field(default_factory=dict, repr=False)
    """Filled as they are needed: many data sets of one design share them."""

    @classmethod
    def of(
        cls, signatures: Signatures, known: FloatArray, points: FloatArray, inflation: float = 1.0
    ) -> Design:
        """Set up for tests at ``points`` (n, dim) in the unit box; ``known`` (m, dim) are the bank's."""
        layout = Layout.of(signatures, known, points, inflation)
        through = layout.through
        mus, lines, coordinates = [], [], []
        for place, curve in enumerate(signatures.curves):
            mus.append(np.einsum("qm,gmk->gqk", through, curve.change).reshape(len(curve.coordinates), -1))
            lines.append(np.full(len(curve.coordinates), place))
            coordinates.append(curve.coordinates)
        names = [curve.line.effect for curve in signatures.curves]
        effects = tuple(dict.fromkeys(names))
        line = np.concatenate(lines)
        effect = np.array([effects.index(names[i]) for i in line])
        mu = np.concatenate(mus)
        coordinate = np.concatenate(coordinates)
        columns = []
        for place in range(len(signatures.curves)):
            mine = np.flatnonzero(line == place)
            near = mine[np.argmin(np.abs(coordinate[mine]))]
            columns.append(mu[near] / coordinate[near] * BACKGROUND)
        # What other numerics do is no cause: it may all be there, at full size.
        columns += [(through @ change).ravel() for change in signatures.numerics]
        j = np.stack(columns, axis=1)
        covariance = np.kron(layout.scatter, signatures.noise) + j @ j.T
        covariance[np.diag_indices_from(covariance)] += GROUND**2 / len(through)
        spectrum, vectors = np.linalg.eigh(covariance)
        rotate = vectors.T
        candidates = Candidates(mu @ vectors, line, effect, coordinate, effects)
        return cls(signatures, layout, candidates, spectrum, rotate)

    def level(self, exponent: int) -> Level:
        """Return the signatures under form error η = 2^exponent."""
        if exponent not in self.levels:
            v = 1.0 / (self.spectrum + 4.0**exponent)
            root = np.sqrt(v)
            mu = self.candidates.mu * root
            self.levels[exponent] = Level(root, 0.5 * float(np.log(v).sum()), mu, mu @ mu.T)
        return self.levels[exponent]

    def coefficients(self, components: FloatArray) -> FloatArray:
        """Return (q, k) of components (n, k) of the rollouts."""
        found: FloatArray = self.layout.project @ components
        return found

    def data(self, coefficients: FloatArray) -> FloatArray:
        """Return (D,) of coefficients (q, k), in the design's own axes."""
        found: FloatArray = self.rotate @ coefficients.ravel()
        return found


def _basis(points: FloatArray) -> FloatArray:
    """Return as many functions of the test as these tests can tell apart."""
    full = basis(points)
    distinct = len(np.unique(points.round(9), axis=0)) if points.shape[1] else 1
    wanted = min(full.shape[1], max(1, distinct - 1)) if distinct > 1 else 1
    for count in range(wanted, 1, -1):
        b = full[:, :count]
        if np.linalg.cond(b) < 30.0:
            return b
    return full[:, :1]


@dataclass(frozen=True)
class Level:
    """The signatures at one form error: whitened, with their Gram matrix."""

    root: FloatArray
    constant: float
    mu: FloatArray
    gram: FloatArray


@dataclass(frozen=True)
class Evidence:
    """Log evidence of sets of effects, up to one constant.

    Attributes:
        none: of no effect.
        single: (K,) of each.
        pair: (K, K) of each two; −inf on the diagonal.
        best: (K,) candidate that fits best, of each effect.
        best_pair: (K, K, 2) candidates that fit best together.
        share: (K,) part of the energy that the best candidate of each effect explains.
        left: (4,) part of the energy that is left after the best 0, 1, 2 and 3 effects.
        triple: the three effects behind the last of these.
        misfit: (4,) mean square of what is left, in units of scatter, background and numerics.
        energy: mean square of the data per dimension.
    """

    none: float
    single: FloatArray
    pair: FloatArray
    best: NDArray[np.int64]
    best_pair: NDArray[np.int64]
    share: FloatArray
    left: FloatArray
    triple: tuple[int, ...]
    misfit: FloatArray
    energy: float


def evidence(design: Design, z: FloatArray, without: int | None = None) -> Evidence:
    """Score every set of at most two effects; ``without`` one of the catalogue, if given."""
    c = design.candidates
    count = len(c.effects)
    energy = float(z @ z) / len(z)
    top = round(0.5 * np.log2(max(energy, 1e-12)))
    singles, pairs, nones = [], [], []
    gains1, gains2 = [], []
    barred = np.flatnonzero(c.effect == without) if without is not None else None
    for exponent in range(top - LEVELS + 1, top + 1):
        level = design.level(exponent)
        y = z * level.root
        zz = float(y @ y)
        gain1 = level.mu @ y - 0.5 * np.diag(level.gram)
        if barred is not None:
            gain1[barred] = -np.inf
        gain2 = gain1[:, None] + gain1[None, :] - level.gram
        base = level.constant - 0.5 * zz
        nones.append(base)
        singles.append(base + _pooled(gain1[:, None], c.starts)[:, 0])
        pairs.append(base + _pooled(_pooled_columns(gain2, c.starts), c.starts))
        gains1.append(gain1)
        gains2.append((gain2, zz, level))
    log = np.log(LEVELS)
    pair = logsumexp(np.array(pairs), axis=0) - log
    single = logsumexp(np.array(singles), axis=0) - log
    # An effect of several parameters may have two of them off nominal at once.
    several = np.array([len(set(c.line[c.effect == k])) > 1 for k in range(count)])
    both = np.logaddexp(single, np.diag(pair)) - np.log(2.0)
    single = np.where(several, both, single)
    pair[np.diag_indices(count)] = -np.inf
    gain2, zz, level = gains2[LEVELS // 2 - 1]
    gain1 = gains1[LEVELS // 2 - 1]
    best_pair = _best_pairs(gain2, c.starts)
    block = np.maximum.reduceat(np.maximum.reduceat(gain2, c.starts, axis=0), c.starts, axis=1)
    block[np.diag_indices(count)] = -np.inf
    i, j = np.unravel_index(int(block.argmax()), block.shape) if count > 1 else (0, 0)
    picked = [int(k) for k in (best_pair[i, j] if count > 1 else [int(gain1.argmax())])]
    gain3 = gain1 - level.gram[picked].sum(axis=0)
    for k in picked:
        gain3[c.effect == c.effect[k]] = -np.inf
    third = int(gain3.argmax())
    sets: list[list[int]] = [
        [],
        [int(gain1.argmax())],
        picked,
        [*picked, *([third] if np.isfinite(gain3[third]) else [])],
    ]
    left = [
        float(((z - c.mu[s].sum(axis=0)) * level.root) @ ((z - c.mu[s].sum(axis=0)) * level.root)) / zz
        for s in sets
    ]
    misfit = [float(((z - c.mu[s].sum(axis=0)) ** 2 / design.spectrum).mean()) for s in sets]
    top1 = np.maximum.reduceat(gain1, c.starts)
    return Evidence(
        float(logsumexp(nones) - log),
        single,
        pair,
        np.array(
            [
                s + int(np.argmax(gain1[s:e]))
                for s, e in zip(c.starts, [*c.starts[1:], len(gain1)], strict=True)
            ]
        ),
        best_pair,
        np.maximum(2.0 * top1 / zz, 0.0),
        np.array(left),
        tuple(int(c.effect[k]) for k in sets[3]),
        np.array(misfit),
        energy,
    )


def _pooled(gain: FloatArray, starts: NDArray[np.int64]) -> FloatArray:
    """Return log means of exp(gain) over each effect's rows."""
    peak = np.maximum.reduceat(gain, starts, axis=0)
    peak = np.where(np.isfinite(peak), peak, -1e300)
    sizes = np.diff(np.append(starts, len(gain)))
    total = np.add.reduceat(np.exp(gain - np.repeat(peak, sizes, axis=0)), starts, axis=0)
    with np.errstate(divide="ignore"):
        found: FloatArray = peak + np.log(total / sizes[:, None])
    return found


def _pooled_columns(gain: FloatArray, starts: NDArray[np.int64]) -> FloatArray:
    return _pooled(np.ascontiguousarray(gain.T), starts).T


def _best_pairs(gain: FloatArray, starts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return (K, K, 2): the best candidates of each two effects."""
    ends = [*starts[1:], len(gain)]
    count = len(starts)
    found = np.zeros((count, count, 2), dtype=np.int64)
    for i in range(count):
        for j in range(count):
            block = gain[starts[i] : ends[i], starts[j] : ends[j]]
            a, b = divmod(int(block.argmax()), block.shape[1])
            found[i, j] = starts[i] + a, starts[j] + b
    return found
