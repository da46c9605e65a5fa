"""Likelihood of the sizes of all effects: a hierarchical model in which every group of observables has a law error.

Data: for every group g of observables (one quantity and one statistic in one experiment) the mean y_g (n_g,) over
real runs. Unknown: θ (K,), the parameters of the catalogue in typical sizes; φ (V,), amounts of the simulator's
variants. Model:

    y_g = F_g(θ + b_g, φ + c_g) + ε_g           F_g: the simulator's mean, linear around the present θ
    b_g ~ N(0, τ_g² I_K + ρ_g² diag(θ²))          law error: the machine's laws are not the simulator's, so that
    c_g ~ N(0, 4 τ_g² I_V)                        each group sees the size of an effect with an error of its own
    ε_g ~ N(0, s_g² diag(u_g²) n_g/N_g)           scatter and form error, of N_g independent numbers
    φ ~ N(0, I_V),   τ_g² ~ Inv-χ²(ν, τ0²),   s_g² ~ Inv-χ²(ν, 1)

u_g (n_g,) is the known shape of the error (:mod:`.observation`), ρ_g the relative error of a sum of responses, and N_g
the effective number of independent errors (:mod:`.additivity`). A group that the model cannot follow gets a large τ_g
or s_g, and counts little, so no channel needs a tolerance of its own: a random-effects meta-analysis.

Estimator: s_g² and τ_g² are at the mode of their marginal posterior (MacKay's fixed point), given θ. Then group g
says about (θ, φ), with its information I_g = N_g/(n_g s_g²) M_gᵀ M_g and score h_g,

    information (I_g⁻¹ + T_g)⁻¹,   score (1 + I_g T_g)⁻¹ h_g,   T_g = diag(τ_g² I_K + ρ_g² diag(θ²), 4 τ_g² I_V)

The sum of these over g, with φ integrated out, is the *groupwise* likelihood, of information J and score h. Two errors
are common to several groups, so they do not average out:

    form    an effect has another shape, in all groups of one kind of motion c:
            J becomes (J⁻¹ + J⁻¹ Q J⁻¹)⁻¹, and h becomes J (J + Q)⁻¹ h,
            Q = Σ_c C_c ∘ O_c diag(ρ0² θ²) O_c,   O_c,jk = Σ_{g in c} (J_g,jj J_g,kk)^½,
            C_c: correlations of J_c = Σ_{g in c} J_g
    size    an effect's size in the laws of another author is not defined any better: the covariance grows by
            σ_c² + ρ0² θ_k² + τ0² (λ_k − 1)

A law that differs by the part ρ changes the signal of effect k in group g by ρ θ_k J_g,kk^½, in units of the error:
along effect j a score of up to ρ θ_k (J_g,jj J_g,kk)^½. Groups of one kind of motion, the tests or a protocol, share
the shape, so these add up to ρ θ_k O_c,jk. The scores of two effects correlate as their signals do. So a fine detail of
shape does not separate two effects.

Two modes differ in log likelihood by h_D − ½ J_D, with the score h_D along D, the difference of their predictions. J_D
sums J_D,g = N_g/(n_g s_g²) |D_g/u_g|² over the groups. Errors of form grow the variance of h_D from J_D to J_D + Q_D,
with Q_D = Σ_c Σ_k ρ² θ_k² (Σ_{g in c} (J_D,g J_g,kk)^½)². With q = Q_D/J_D and ρ² ~ Inv-χ²(ν, ρ0²), this much of a
difference S counts (:func:`score_left`). θ, s_g and J_g are those of the more probable mode.

    S' = −log E_ρ [(1 + q)^−½ exp(−S/(1 + q))]

λ_k ≥ 1 says how much more than by T_g the groups disagree about parameter k: the mode of λ_k ~ Inv-χ²(ν, 1), if T_g is
multiplied by diag(λ). It does not change the weights of groups: groups that all ask for the same θ_k could else count
as large law errors of θ_k = 0.

Units: θ, τ in typical sizes; s dimensionless. Shapes: G groups, D = K + V columns.
Source: Gelman et al., *Bayesian Data Analysis*, 3rd ed., §5.4 and §5.5; MacKay, *Neural Computation* 4 (1992), §4;
White, *Econometrica* 50 (1982) 1 (J⁻¹ Q J⁻¹); Birge, *Physical Review* 40 (1932) 207 (λ).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from s2r_spec.base.arrays import FloatArray

LAW_ERROR = 0.02
"""Prior: scale τ0 of the law error of a group, in typical sizes. Chosen among 0.01, 0.02, 0.05 by the errors on 20 of
the twins of `benchmarks/diagnose/protocol_fit.py`, which are therefore validation."""
LAW_SHARE = 0.1
"""Prior: part ρ0 of an effect's size by which its law is wrong in one kind of motion, and scale of ρ_g and κ_g. A
quarter was tried, too: intervals then hold fewer than 85 % of the truths of two machines of
`benchmarks/blind/development.py`, which are therefore validation."""
DEGREES = 4.0
"""Prior: degrees of freedom ν of both variances of a group. Chosen like τ0, among 1 and 4."""
LARGEST = 60.0
"""Tolerance: a residual beyond so many units counts as that many; a diverged run then stays finite."""
SHARED = 0.03
"""Prior: standard deviation σ_c of the error that all groups share at nominal, in typical sizes: two healthy machines
of different authors differ by so much. Chosen among 0.02 to 0.05 by density of the true sizes and coverage of the
intervals, in 35 twins of `benchmarks/diagnose/protocol_fit.py` and 17 cases of each of four machines of
`benchmarks/blind/development.py`, which are therefore validation."""
NODES = 200
"""Budget: values of ρ over which a density is averaged; a score is then right to 0.001 nat."""
TINY = 1e-9
"""Tolerance: information below this part of the largest counts as none."""
ROUNDS = 20
"""Budget: most rounds of the fixed points of variances at an estimate. They end before where nothing changes."""
CONSTANT = 1e-3
"""Tolerance: a fixed point ends where no variance changes by more than this part. Evidence is flat there."""
VARIANT = 2.0
"""Prior: error of a variant's amount in a group, in units of τ_g; a variant is known less well than an effect. No
source: a judgement."""


@dataclass(frozen=True)
class Groups:
    """Groups of one experiment at one θ, reduced to what the likelihood needs; r_g and M_g are in units of u_g.

    Attributes:
        gram, moment, energy: (G, D, D) M_gᵀ M_g / n_g, (G, D) M_gᵀ r_g / n_g, and (G,) r_gᵀ r_g / n_g.
        volume: (G,) mean of log u_g².
        size, coherent: (G,) N_g and ρ_g.
    """

    gram: FloatArray
    moment: FloatArray
    energy: FloatArray
    volume: FloatArray
    size: FloatArray
    coherent: FloatArray

    @classmethod
    def of(
        cls,
        residual: FloatArray,
        columns: FloatArray,
        unit: FloatArray,
        parts: Sequence[slice],
        coherent: FloatArray,
        size: FloatArray,
    ) -> Groups:
        """Reduce a residual (m,) and columns (D, m), with u (m,); ``parts`` are the places of each group."""
        r, columns = np.clip(residual / unit, -LARGEST, LARGEST), columns / unit
        logs, gram, moment, energy, volume = np.log(unit), [], [], [], []
        for part in parts:
            m, own = np.asfortranarray(columns[:, part]), r[part]
            gram.append(m @ m.T / own.size)
            moment.append(m @ own / own.size)
            energy.append(float(own @ own) / own.size)
            volume.append(2.0 * float(logs[part].mean()))
        return cls(np.array(gram), np.array(moment), np.array(energy), np.array(volume), size, coherent)

    @classmethod
    def joined(cls, groups: Sequence[Groups]) -> Groups:
        """Return the groups of several experiments as one."""
        rows = [(g.gram, g.moment, g.energy, g.volume, g.size, g.coherent) for g in groups if g.size.size]
        return cls(*(np.concatenate(each) for each in zip(*rows, strict=True)))

    def law_prior(self, variances: Variances, theta: FloatArray) -> FloatArray:
        """Return (G, D) the diagonal of T_g for (G,) ρ_g and (K,) θ."""
        columns = self.gram.shape[1]
        sizes = np.concatenate([theta**2, np.zeros(columns - theta.size)])
        amounts = _amounts(columns, theta.size)
        return np.asarray(variances.law[:, None] * amounts + self.coherent[:, None] ** 2 * sizes)

    def variances(self, theta: FloatArray, start: Variances, rounds: int = 3) -> Variances:
        """Return s_g² and τ_g² at the mode of their marginal posterior, after so many rounds of the fixed point."""
        current, amounts = start, _amounts(self.gram.shape[1], theta.size)
        for _ in range(rounds):
            prior = self.law_prior(current, theta)
            mean, covariance = self._law_errors(prior, current.noise)
            determined = 1.0 - np.einsum("gii->gi", covariance) / prior
            left = (
                self.energy
                - 2.0 * np.einsum("gi,gi->g", mean, self.moment)
                + np.einsum("gi,gij,gj->g", mean, self.gram, mean)
                + np.einsum("gij,gji->g", covariance, self.gram)
            )
            noise = (DEGREES + self.size * left) / (DEGREES + self.size)
            own = current.law[:, None] * amounts / prior  # the part that does not grow with the size
            energy = ((own * mean) ** 2 / amounts).sum(axis=1)
            law = (DEGREES * LAW_ERROR**2 + energy) / (DEGREES + (own * determined).sum(axis=1))
            last, current = current, Variances(noise, law)
            if _constant(last.noise, noise) and _constant(last.law, law):
                break
        return current

    def _law_errors(self, prior: FloatArray, noise: FloatArray) -> tuple[FloatArray, FloatArray]:
        columns = prior.shape[1]
        weight = self.size / noise
        precision = weight[:, None, None] * self.gram
        precision[:, range(columns), range(columns)] += 1.0 / prior
        covariance = np.linalg.inv(precision)
        return np.einsum("gij,gj->gi", covariance, weight[:, None] * self.moment), np.asarray(covariance)

    def disagreement(self, theta: FloatArray, variances: Variances) -> FloatArray:
        """Return (K,) λ, by which groups disagree more about each parameter than by their law errors; at least 1."""
        shape = self.law_prior(variances, theta)
        scale = np.ones(shape.shape[1])
        for _ in range(ROUNDS):
            prior = shape * scale
            mean, covariance = self._law_errors(prior, variances.noise)
            determined = 1.0 - np.einsum("gii->gi", covariance) / prior
            last = scale
            scale = (DEGREES + (mean**2 / shape).sum(axis=0)) / (DEGREES + determined.sum(axis=0))
            if _constant(last, scale):
                break
        return np.maximum(scale[: theta.size], 1.0)

    def likelihood(self, theta: FloatArray, variances: Variances) -> Likelihood:
        """Return the likelihood of (θ, φ) around θ from all groups, without the shared error."""
        score = (self.size / variances.noise)[:, None] * self.moment
        information, prior, damping = self._damped(theta, variances)
        solved = np.linalg.solve(damping, np.concatenate([information, score[..., None]], axis=2))
        total = solved[..., :-1].sum(axis=0)
        # log N(r_g; 0, S_g + M_g T_g M_gᵀ), of N_g numbers; then the priors of both variances.
        explained = np.einsum("gi,gi->g", score, prior * solved[..., -1])
        fitted = self.size * (self.volume + np.log(variances.noise)) + np.linalg.slogdet(damping)[1]
        fitted += self.size * self.energy / variances.noise - explained
        value = -0.5 * float(fitted.sum())
        for variance, scale in ((variances.noise, 1.0), (variances.law, LAW_ERROR**2)):
            value -= 0.5 * DEGREES * float((np.log(variance / scale) + scale / variance).sum())
        return Likelihood((total + total.T) / 2.0, np.asarray(solved[..., -1].sum(axis=0)), value)

    def _damped(self, theta: FloatArray, variances: Variances) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return (G, D, D) I_g, (G, D) the diagonal of T_g, and (G, D, D) 1 + I_g T_g."""
        information = (self.size / variances.noise)[:, None, None] * self.gram
        prior = self.law_prior(variances, theta)
        return information, prior, np.eye(prior.shape[1]) + information * prior[:, None, :]

    def information(self, theta: FloatArray, variances: Variances) -> FloatArray:
        """Return (G, K, K) every group's information about θ."""
        information, _, damping = self._damped(theta, variances)
        own = np.linalg.solve(damping, information)[:, : theta.size, : theta.size]
        return np.asarray((own + own.transpose(0, 2, 1)) / 2.0)


@dataclass(frozen=True)
class Variances:
    """Variances (G,) of every group: s_g² of the noise, and τ_g² of the law."""

    noise: FloatArray
    law: FloatArray

    @classmethod
    def prior(cls, groups: int) -> Variances:
        """Return their prior scales."""
        return cls(np.ones(groups), np.full(groups, LAW_ERROR**2))


@dataclass(frozen=True)
class Likelihood:
    """A Gaussian likelihood of (θ, φ) around a point: information (D, D), score (D,), and its logarithm there.

    The logarithm is known up to a constant of the data.
    """

    information: FloatArray
    score: FloatArray
    value: float = 0.0

    def with_form_error(self, form: FloatArray) -> Likelihood:
        """Return the likelihood with (K, K) Q added to the covariance of its score.

        Where two effects have the same response, J is singular: all is computed in the space that it spans.
        """
        values, vectors = np.linalg.eigh(self.information)
        spanned = values > TINY * max(values.max(initial=0.0), TINY)
        root, vectors = np.sqrt(values[spanned]), vectors[:, spanned]
        inside = (vectors / root).T @ form @ (vectors / root)
        total, score = np.eye(root.size) + inside, (vectors.T @ self.score) / root
        solved = np.linalg.solve(total, np.column_stack([(vectors * root).T, score]))
        # The last two terms are log N(h; 0, J + Q) − log N(h; 0, J).
        value = (
            self.value
            + 0.5 * float(score @ inside @ solved[:, -1])
            - 0.5 * float(np.linalg.slogdet(total)[1])
        )
        information = (vectors * root) @ solved[:, :-1]
        return Likelihood((information + information.T) / 2.0, (vectors * root) @ solved[:, -1], value)

    def without_variants(self, effects: int) -> Likelihood:
        """Return the likelihood of θ alone: φ is integrated out."""
        score, value = self.score, self.value
        (a, b), (_, c) = (np.split(rows, [effects], axis=1) for rows in np.split(self.information, [effects]))
        if c.size:
            precision = c + np.eye(len(c))
            solved = np.linalg.solve(precision, np.column_stack([b.T, score[effects:]]))
            value += 0.5 * float(score[effects:] @ solved[:, -1]) - 0.5 * float(
                np.linalg.slogdet(precision)[1]
            )
            a, score = a - b @ solved[:, :-1], score[:effects] - b @ solved[:, -1]
        return Likelihood(a, score, value)

    def with_shared_error(self, shared: FloatArray) -> Likelihood:
        """Return the likelihood of θ with (K,) the shared error added to its covariance."""
        # (A⁻¹ + diag(shared))⁻¹ without an inverse of A, which need not exist.
        a, score, value = self.information, self.score, self.value
        damping = np.eye(shared.size) + a * shared
        solved = np.linalg.solve(damping, np.column_stack([a, score]))
        value += 0.5 * float(score @ (shared * solved[:, -1])) - 0.5 * float(np.linalg.slogdet(damping)[1])
        return Likelihood(
            np.asarray((solved[:, :-1] + solved[:, :-1].T) / 2.0), np.asarray(solved[:, -1]), value
        )


def _amounts(columns: int, effects: int) -> FloatArray:
    return np.where(np.arange(columns) < effects, 1.0, VARIANT**2)


def _constant(before: FloatArray, after: FloatArray) -> bool:
    return bool((np.abs(after - before) <= CONSTANT * before).all())


def shared_error(theta: FloatArray, scale: FloatArray) -> FloatArray:
    """Return (K,) the variance of the error of size that all groups share, with (K,) λ."""
    return np.asarray(SHARED**2 + (LAW_SHARE * theta) ** 2 + LAW_ERROR**2 * (scale - 1.0))


def form_error(
    theta: FloatArray, by_group: FloatArray, kinds: Sequence[str], information: FloatArray
) -> FloatArray:
    """Return (K, K) Q, the covariance of the score by errors of form.

    Args:
        theta: (K,) sizes of the effects whose laws differ.
        by_group: (G, K, K) information of every group.
        kinds: of motion, of every group.
        information: (K, K) J; without the part that variants take, so it is at most the sum of ``by_group``.
    """
    root = np.sqrt(np.maximum(np.einsum("gkk->gk", by_group), 0.0))
    total, form = np.zeros_like(information), (LAW_SHARE * theta) ** 2
    for kind in dict.fromkeys(kinds):
        own = np.array([each == kind for each in kinds])
        overlap = root[own].T @ root[own]
        inside = by_group[own].sum(axis=0)
        deviation = np.sqrt(np.maximum(np.diag(inside), TINY))
        total += inside / np.outer(deviation, deviation) * ((overlap * form) @ overlap)
    left = np.sqrt(np.maximum(np.diag(information), 0.0) / np.maximum((root**2).sum(axis=0), TINY))
    return np.asarray(total * np.outer(left, left) ** 2)


def form_ratio(apart: FloatArray, theta: FloatArray, by_group: FloatArray, kinds: Sequence[str]) -> float:
    """Return Q_D/J_D at ρ = 1: the variance of a difference of scores by errors of form, beside that by noise.

    Args:
        apart: (G,) J_D,g of every group.
        theta: (K,) sizes of the effects whose laws differ.
        by_group: (G, K, K) information of every group.
        kinds: of motion, of every group.
    """
    root = np.sqrt(np.maximum(apart[:, None] * np.einsum("gkk->gk", by_group), 0.0))
    form = 0.0
    for kind in dict.fromkeys(kinds):
        overlap = root[np.array([each == kind for each in kinds])].sum(axis=0)
        form += float(((theta * overlap) ** 2).sum())
    total = float(apart.sum())
    return form / total if total > 0.0 else 0.0


def score_left(score: float, ratio: float) -> float:
    """Return S' = −log E_ρ [(1 + q)^−½ exp(−S/(1 + q))], what errors of laws leave of a difference of scores S > 0.

    q is ρ² times a ratio Q_D/J_D at ρ = 1, and ρ² ~ Inv-χ²(ν, ρ0²).
    """
    from scipy.special import logsumexp

    log_share = np.linspace(-4.0, 16.0, NODES)  # of ρ²/ρ0², beyond which there is no part of the prior
    prior = -0.5 * DEGREES * (log_share + np.exp(-log_share))
    log_ratio = np.log1p(ratio * LAW_SHARE**2 * np.exp(log_share))
    worse = logsumexp(prior - score * np.exp(-log_ratio) - 0.5 * log_ratio)
    return min(float(logsumexp(prior) - worse), score)
