"""The specification language: from a text to a checked specification, or to a list of all its mistakes.

The stages::

    text ──lex──▶ tokens ──parse──▶ syntax tree ──rules, check──▶ Document
         (lexing)        (parsing)   (syntax)      (units, formula)

Nothing here evaluates a trace; :mod:`s2r_spec.robustness` does.
"""
