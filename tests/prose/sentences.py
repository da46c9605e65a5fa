"""Sentences of a text, and the number of words in each.

A code span, a formula and the value of an f-string field each count as one word. The caller puts ``SPAN`` in
their place; formulas that are written as plain text (``P(ρ < r) ≤ p``) are found by their operators.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

SPAN = "\ue000"
"""Stands for one word that is not prose: a code span, a formula, a field of an f-string."""

LONGEST = 25
"""Most words of a sentence."""

MEAN = 18.0
"""Upper bound of the mean number of words per sentence of a page."""

_ABBREVIATIONS = frozenset(
    {"e.g.", "i.e.", "cf.", "vs.", "approx.", "resp.", "al.", "fig.", "eq.", "sec.", "no."}
)
_END = re.compile(r"[.!?][\"')\]»”*_]*(?=\s)")
_INITIAL = re.compile(r"(?:^|[\s(])[A-Z]\.$")
_BEFORE_INITIAL = re.compile(r"(?:^|[,;:(]|\band|&|\b[A-Z]\.)\s*[A-Z]\.$")
_OPERATOR = re.compile(r"[=<>≤≥≈≠∈⊂+−×·*/^|‖→↦±∧∨-]+$")
_ALPHANUMERIC = re.compile(rf"[^\W_]|{SPAN}")


@dataclass(frozen=True)
class Measure:
    """Sentences of one page: how many, their mean length in words, and those that are too long."""

    sentences: int
    mean: float
    long: tuple[str, ...]

    @property
    def done(self) -> bool:
        """Whether the page keeps both limits."""
        return not self.long and self.mean < MEAN


def split(text: str) -> list[str]:
    """Return the sentences of one paragraph, in order.

    A full stop, exclamation or question mark before white space ends a sentence, unless it belongs to an abbreviation
    or to the initial of a name. Decimals and versions have no white space after their points.
    """
    text = " ".join(text.split())
    found, begin = [], 0
    for end in _END.finditer(text):
        piece = text[begin : end.end()]
        last = piece.split()[-1].lower().lstrip("(")
        initial = _INITIAL.search(piece) and _BEFORE_INITIAL.search(piece) and text[end.end() + 1].isupper()
        if last in _ABBREVIATIONS or initial:
            continue
        found.append(piece)
        begin = end.end() + 1
    return [*found, text[begin:]] if text[begin:].strip() else found


def words(sentence: str) -> int:
    """Return the number of words; operands joined by operators count as one."""
    count, joined = 0, False
    for token in sentence.split():
        if _OPERATOR.match(token):
            joined = True
        elif _ALPHANUMERIC.search(token):
            count += not (joined and count)
            joined = False
    return count


def measure(paragraphs: Iterable[str], fragments: Iterable[str] = ()) -> Measure:
    """Return the measure of a page.

    Fragments (headings, table cells) may not be too long either, but stay out of the mean: many short cells would
    hide long sentences.
    """
    sentences = [sentence for paragraph in paragraphs for sentence in split(paragraph)]
    counts = [count for sentence in sentences if (count := words(sentence))]
    others = [sentence for fragment in fragments for sentence in split(fragment)]
    long = tuple(
        f"{words(one)}: {one.replace(SPAN, '`…`')}" for one in sentences + others if words(one) > LONGEST
    )
    return Measure(len(counts), sum(counts) / len(counts) if counts else 0.0, long)
