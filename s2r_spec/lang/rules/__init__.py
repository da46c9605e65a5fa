"""Checks of a parsed file as a whole, one module for each rule.

A rule takes a parsed file and yields every place that breaks it. Checks that need names and units are made with the
expressions (:mod:`s2r_spec.lang.checking`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from s2r_spec.lang.diagnostics import Diagnostic
from s2r_spec.lang.parsing import Parsed
from s2r_spec.lang.rules.certify_targets import certify_targets
from s2r_spec.lang.rules.chained_until import chained_until
from s2r_spec.lang.rules.complete_params import complete_params
from s2r_spec.lang.rules.some_requirement import some_requirement
from s2r_spec.lang.rules.unique_names import unique_names

Rule = Callable[[Parsed], Iterator[Diagnostic]]

RULES: tuple[Rule, ...] = (some_requirement, unique_names, complete_params, chained_until, certify_targets)
