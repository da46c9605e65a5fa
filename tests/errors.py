"""Facts that a message must state, whatever its sentence."""

import re


def naming(*facts: str) -> str:
    """Return a pattern that finds each of these facts in a text, in any order: places, names, units, figures.

    A fact is found as a whole: ``vx`` not in ``vx_cmd``, ``1 s`` not in ``0.1 s``.
    """
    return r"(?s)\A" + "".join(rf"(?=.*{_whole(fact)})" for fact in facts)


def states(text: str, *facts: str) -> bool:
    """Return whether a text has all of the facts."""
    return re.search(naming(*facts), text) is not None


def _whole(fact: str) -> str:
    before = r"(?<![\w.])" if fact[:1].isalnum() else ""
    after = r"(?!\w|\.\d)" if fact[-1:].isalnum() else ""
    return before + re.escape(fact) + after
