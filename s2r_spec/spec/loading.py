"""From text to a checked specification."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from s2r_spec.lang.files import read_text
from s2r_spec.spec.evaluated import Spec


def parse_spec(text: str, name: str = "<string>", *, imports: Mapping[str, str] | None = None) -> Spec:
    """Return the specification that a text means.

    Args:
        text: the specification.
        name: what it goes by; files that it imports are looked for beside this path.
        imports: name → text of every file that it imports, as :attr:`Spec.imported` has them; none is read then.

    Raises:
        SpecError: with every mistake of the text, drawn with line and caret.
    """
    # the parser and the units cost half a second to import: only who parses pays
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
