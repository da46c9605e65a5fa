"""Mistakes of the recordings: what looks like physics and is the recording's doing.

Data: n recordings y (n, T, c) of c columns at T instants from the first sample on, at their declared tests. Unknown:
a mistake g of one kind and size (a delay, a clock, an exchange, a sign, a scale, a turn, an offset, another test), and
the machine θ, in units of the simulated sizes of the catalogue's effects. Model, for each recording i:

    g⁻¹(y_i) = f_i + J_i θ + ε_i,    θ ~ N(0, 1),    ε_i ~ N(0, C_i),    C_i = F² + D_iᵀD_i

    f_i  (T·c)      mean of nominal rollouts at the test           F  (c)  floor: 1 % of each column's range, and what
    J_i  (k, T·c)   changes along the catalogue, at every value            the scatter has beyond what D has learnt
    D_i  (s, T·c)   deviations of s nominal rollouts               Q(g) = rᵀ(C + JJᵀ)⁻¹r / (n T c),  r = g⁻¹(y) − f

Relations that hold in the simulator whatever effect is added (a distance and a position, a speed and what it leads to)
are in D and J: what breaks them is far from both. Estimator: the g of least Q. Where the machine may be far from
nominal, f, C are those of the machine that fits best, by simulation (:mod:`.physics`). It is a *finding* where

    ℓ(no mistake, best machine) − ℓ(g) ≥ MOST · (ℓ(no mistake, best machine) − usual),    ℓ = Q + log |C| / (T c)

and the difference itself is of CLEAR · usual, with usual the Q of a fresh nominal rollout. A mistake that does the same
as the best machine is a finding, too, and says so: then no data of these channels tell the two apart.

Units: r, J, D in floors; Q, ℓ dimensionless. Source: marginal likelihood of a linear Gaussian model (Rasmussen &
Williams 2006, §2.7, explicit basis functions; Woodbury), generalised-likelihood-ratio tests (Basseville & Nikiforov
1993, ch. 7).

One check a file. :mod:`.late`, :mod:`.clock`, :mod:`.exchanged`, :mod:`.sign`, :mod:`.scale`, :mod:`.frame` and
:mod:`.labels` propose, and :mod:`.decide` judges all by this rule. Checks that need no model stand beside them
(:mod:`.direct`): a channel is compared with the simulator's (:mod:`.still`, :mod:`.wrapped`, :mod:`.factor`,
:mod:`.begin`, :mod:`.hold`), or a rollout with the others (:mod:`.spike`, :mod:`.stopped`, :mod:`.copied`).
"""

from s2r_spec.diagnose.quality.decide import findings
from s2r_spec.diagnose.quality.finding import Finding

__all__ = ["Finding", "findings"]
