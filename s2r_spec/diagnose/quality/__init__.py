"""Mistakes of the recordings: what looks like physics and is the recording's doing.

Data: n recordings y (n, T, c) of c columns at T instants from the first sample on, at their declared tests. Unknown:
a mistake g of a declared family (:mod:`.faults`, :mod:`.labels`), and the machine θ, in typical sizes of the
catalogue's effects. Model, for each recording i:

    g⁻¹(y_i) = f_i + J_i θ + ε_i,    θ ~ N(0, 1),    ε_i ~ N(0, C_i),    C_i = F² + D_iᵀD_i

    f_i  (T·c)      mean of nominal rollouts at the test           F  (c)  floor: 0.7 % of each column's range, and
    J_i  (k, T·c)   changes at typical sizes, on both sides                the scatter beyond what D has learnt
    D_i  (s, T·c)   deviations of s nominal rollouts               Q(g) = rᵀ(C + JJᵀ)⁻¹r / (n T c),  r = g⁻¹(y) − f

Relations that hold in the simulator whatever effect is added (a distance and a position, a speed and what it leads to)
are in D and J: what breaks them is far from both. Estimator: the size and the channels of g of least Q. Where the
machine may be far from nominal, f and C are those of the nearest one, by simulation (:mod:`.comparison`). A mistake is
a *finding* (:mod:`.decide`) where

    ℓ(no mistake, best machine) − ℓ(g) ≥ MOST · (ℓ(no mistake, best machine) − usual)
    ℓ(g) = Q(g) + (log |C| + 2 log |∂y / ∂g⁻¹(y)|) / (n T c)

and the difference itself is of CLEAR · usual, with usual the Q of a fresh nominal rollout. A mistake that alone makes
the recordings as usual, while a machine does so, too, is a finding of the *same*: no data tell the two apart. What is
too short or in too few rollouts for this is found in single channels (:mod:`.channels`).

Where the simulator knows the law of its controller, recordings that break it are found before all this, exactly and
without a simulation (:mod:`.law`). Such a finding is *certain*: nothing is estimated from these recordings.

Units: r, J, D in floors; Q, ℓ dimensionless. Source: marginal likelihood of a linear Gaussian model (Rasmussen &
Williams 2006, §2.7, explicit basis functions; Woodbury), generalised-likelihood-ratio tests (Basseville & Nikiforov
1993, ch. 7).
"""

from s2r_spec.diagnose.quality.decide import certain_findings, findings, likely_findings
from s2r_spec.diagnose.quality.finding import Finding
from s2r_spec.diagnose.quality.loop import Loop, unstated, with_loop_of

__all__ = ["Finding", "Loop", "certain_findings", "findings", "likely_findings", "unstated", "with_loop_of"]
