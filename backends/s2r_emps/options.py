"""Read the options after the colon of the backend's name, and write them."""

from __future__ import annotations

from s2r_emps.effects import CATALOGUE
from s2r_spec.effects import Choice, choose, read_word, words
from s2r_spec.errors import UsageError, did_you_mean

_REFERENCE = "reference"


def read_options(text: str, reference: str, added: Choice) -> tuple[str, Choice]:
    """Return the reference and the effects, updated with options such as ``reference=DATA_EMPS.mat,coulomb.force=20``.

    Args:
        text: the options.
        reference: the reference before the options.
        added: the effects before the options.

    Raises:
        UsageError: an option is unknown, or its value is wrong.
    """
    for word in filter(None, text.split(",")):
        name, _, value = word.partition("=")
        if name == _REFERENCE and value:
            reference = value
        elif values := read_word(word):
            added = choose("emps", CATALOGUE.values(), added, values)
        else:
            raise UsageError(
                f"the backend 'emps' has no option {word!r}{did_you_mean(name, [_REFERENCE])}; its options are "
                f"reference=FILE.mat and the parameters of its effects, such as coulomb.force=20"
            )
    return reference, added


def write_options(reference: str, added: Choice) -> str:
    """Return the options as text that :func:`read_options` reads."""
    return ",".join(([f"{_REFERENCE}={reference}"] if reference else []) + words(added))
