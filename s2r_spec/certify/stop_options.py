"""The stopping rule of a run: the one of its options, or of the run that it resumes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from s2r_spec.certify.options import RunOptions
from s2r_spec.errors import UsageError
from s2r_spec.rollouts.journal import Journal
from s2r_spec.rollouts.stop_rule import BUDGET, EPSILON, stop_of


def with_rule(options: RunOptions, *places: Path) -> RunOptions:
    """Return options with a stopping rule.

    Args:
        options: the options of the run.
        places: the folders of the search's journals; the rule of one that has begun is the default of a resumed run.

    Raises:
        UsageError: only a budget ends the search, and there is none; or the journal is damaged.
    """
    stop = options.stop
    if stop is None:
        begun = [place for place in places if options.resume and Journal.begun(place)]
        stop = stop_of(Journal.read(begun[0]).header) if begun else EPSILON
    if stop == BUDGET and options.budget is None:
        raise UsageError("stop = 'budget' needs a budget: the largest number of rollouts")
    return replace(options, stop=stop)


def refuse_rule(stop: str, backend: str) -> None:
    """Refuse a stopping rule for recordings.

    Args:
        stop: the rule.
        backend: the name of the backend of recordings.

    Raises:
        UsageError: it is not the usual one.
    """
    if stop != EPSILON:
        raise UsageError(
            f"stop = {stop!r} does not apply to {backend}: its tests are fixed, and s2r uses all of its recordings"
        )
