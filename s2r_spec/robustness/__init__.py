"""Quantitative semantics: how far a trace is from violating, or satisfying, a formula."""
