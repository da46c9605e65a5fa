"""Quantitative semantics of formulas: the margin ρ by which a trace satisfies or violates them."""
