"""What may follow the colon in the name of the backend, and how a backend is written as a name."""

from __future__ import annotations

from s2r_emps.effects import CATALOGUE
from s2r_spec.effects import Choice, choose, read_word, words
from s2r_spec.errors import UsageError, did_you_mean

_REFERENCE = "reference"


def read_options(text: str, reference: str, added: Choice) -> tuple[str, Choice]:
    """Return reference and effects with a text such as ``reference=DATA_EMPS.mat,coulomb.force=20`` read into them.

    Raises:
        UsageError: a name or a value is unknown; the message lists those that are known.
    """
    for word in filter(None, text.split(",")):
        name, _, value = word.partition("=")
        if name == _REFERENCE and value:
            reference = value
        elif values := read_word(word):
            added = choose("emps", CATALOGUE.values(), added, values)
        else:
            raise UsageError(
                f"the backend 'emps' has no option {word!r}{did_you_mean(name, [_REFERENCE])}; it has "
                f"reference=FILE.mat, and every parameter of every effect (coulomb.force=20)"
            )
    return reference, added


def write_options(reference: str, added: Choice) -> str:
    """Return the text that :func:`read_options` would read this from."""
    return ",".join(([f"{_REFERENCE}={reference}"] if reference else []) + words(added))
