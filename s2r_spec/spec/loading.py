"""From text to a checked specification."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from s2r_spec.lang.files import read_text
from s2r_spec.spec.evaluated import Spec


def parse_spec(text: str, name: str = "<string>", *, imports: Mapping[str, str] | None = None) -> Spec:
    """Return the specification of a text.

    Args:
        text: the specification.
        name: the path of the specification; imported files are relative to it.
        imports: name → text of every file that it imports, as in :attr:`Spec.imported`; None to read the files.

    Raises:
        SpecError: the text has mistakes; the message shows each with line and caret.
    """
    # the parser and the units take half a second to import, so they are imported here
    from s2r_spec.lang.checking import check_text

    document = check_text(text, name, imports)
    return Spec(
        name,
        document.source.text,
        {source.name: source.text for source in document.imports},
        document.signals,
        document.params,
        document.requirements,
        document.certify,
    )


def load_spec(path: str | Path) -> Spec:
    """Read a specification from a file (UTF-8).

    Raises:
        UsageError: see :func:`read_text`.
        SpecError: see :func:`parse_spec`.
    """
    return parse_spec(read_text(path), str(path))
