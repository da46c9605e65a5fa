"""The specification language: text in, a checked specification or all of its errors out.

The way of a specification through this package::

    text ──lex──▶ tokens ──parse──▶ syntax tree ──rules, check──▶ Document
         (lexing)        (parsing)   (syntax)      (units, formula)

Nothing here evaluates a trace; :mod:`s2r_spec.robustness` does.
"""
