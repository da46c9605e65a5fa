"""The tables of a backend's reference page, from its own declarations.

    python -m benchmarks.tables emps

Tests hold the pages under docs/reference/ to what this prints.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable

from s2r_spec.backend import Backend, HasEffects, load_backend


def table(head: tuple[str, ...], rows: Iterable[tuple[object, ...]]) -> str:
    """Return rows under their head, as a table in Markdown."""
    lines = [head, tuple("---" for _ in head), *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines)


def parameters(backend: Backend) -> str:
    return table(
        ("parameter", "unit", "range", "default", ""),
        [
            (f"`{p.name}`", p.unit, f"{p.low:g} to {p.high:g}", f"{p.default:g}", p.description)
            for p in backend.parameters
        ],
    )


def channels(backend: Backend) -> str:
    return table(
        ("channel", "unit", "width", ""),
        [(f"`{c.name}`", c.unit, c.width, c.description) for c in backend.channels],
    )


def effects(backend: Backend) -> str:
    rows: list[tuple[object, ...]] = []
    for effect in backend.effects() if isinstance(backend, HasEffects) else ():
        for k, p in enumerate(effect.parameters):
            first = (f"`{effect.name}`", effect.family) if k == 0 else ("", "")
            words = effect.physics if k == 0 else ""
            rows.append(
                (*first, f"`{p.name}`", p.unit, f"{p.low:g} to {p.high:g}", f"{p.nominal:g}", p.prior, words)
            )
    return table(("effect", "family", "parameter", "unit", "range", "nominal", "prior", "physics"), rows)


TABLES = (parameters, channels, effects)

if __name__ == "__main__":
    print("\n\n".join(make(load_backend(sys.argv[1])) for make in TABLES))
