"""The stopping rule, the seed and the folders of a run: those of its options, or of the run that it resumes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from s2r_spec.base.errors import UsageError, one_of
from s2r_spec.certify.arguments import require_begun
from s2r_spec.certify.options import Execution, RunOptions
from s2r_spec.runs import layout
from s2r_spec.runs.journal import Journal
from s2r_spec.runs.lines import is_count
from s2r_spec.runs.seeds import NEW_SEED, inherited_seed
from s2r_spec.runs.stop_rule import BUDGET, EPSILON, stop_of

Options = TypeVar("Options", bound=Execution)


def with_rule(options: RunOptions, *places: Path) -> RunOptions:
    """Return options with a stopping rule: the given one, or that of the resumed journal in one of the places.

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


def with_seed(options: Options, *places: Path) -> Options:
    """Return options with a seed: the given one, or that of the resumed run; see :func:`seed_of`."""
    return replace(options, seed=seed_of(options.seed, *(places if options.resume else ())))


def seed_of(given: int | None, *places: Path) -> int:
    """Return the seed of a run: the given one, that of the journals of a resumed run, or that of a new one.

    Raises:
        UsageError: the run has another seed, or the first line of a journal is damaged.
    """
    for place in places:
        seed = Journal.header_in(place).get("seed")
        if seed is not None and is_count(seed):  # the check of the whole header names a fault
            return inherited_seed(place, seed, given)
    return NEW_SEED if given is None else given


def places_of(folder: Path, requirements: Sequence[str], resume: bool) -> dict[str, Path]:
    """Return requirement → folder of its journal, for a run that checks several requirements.

    The folder of a resumed run may also be that of one of its journals.

    Raises:
        UsageError: there is no run to resume, or the folder's journal is of something else.
    """
    if not resume:
        return layout.places(folder, requirements, None)
    places = layout.places(folder, requirements, _direct_requirement(folder, requirements))
    require_begun([*places.values()], folder)
    return places


def _direct_requirement(folder: Path, requirements: Sequence[str]) -> str | None:
    """Return the requirement whose journal lies directly in a folder; None if the folder holds a whole run."""
    header = Journal.header_in(folder)
    own = header.get("requirement")
    if header and (own not in requirements or "side" in header):
        of = f"of the requirement {own!r}" if own not in requirements else "a part of a gap"
        raise UsageError(
            f"the run in {folder} is {of}, but this command checks {one_of(requirements)}; begin a new run with --run"
        )
    return own


def refuse_rule(stop: str, backend: str) -> None:
    """Refuse any stopping rule but the usual one for recordings.

    Raises:
        UsageError: it is not the usual one.
    """
    if stop != EPSILON:
        raise UsageError(
            f"stop = {stop!r} does not apply to {backend}: its tests are fixed, and s2r uses all of its recordings"
        )
