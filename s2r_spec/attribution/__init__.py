"""Which time, which channel and which part of the formula make the gap between two rollouts: exact attribution of Δρ.

Data: a real and a simulated trace of one test, and a requirement. Quantity: Δρ = ρ_real − ρ_sim, in the unit of ρ.
:func:`~s2r_spec.attribution.attribute.attribute` divides it into parts that add up to it. No part is estimated.
"""
