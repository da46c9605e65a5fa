"""Effects that change nothing at the tests of a spec: whether they are there no data can say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from s2r_spec.diagnose.bank import Bank


def active(bank: Bank) -> tuple[Bank, tuple[str, ...]]:
    """Return the bank without such effects, and their names; all of it where nothing changes anything."""
    effects = dict.fromkeys(line.effect for line in bank.lines)
    moves = {
        line.effect
        for line, change in zip(bank.lines, bank.changes, strict=True)
        if np.any(np.nan_to_num(change))
    }
    kept = [k for k, line in enumerate(bank.lines) if line.effect in moves]
    if len(kept) in (0, len(bank.lines)):
        return bank, ()
    place = {k: n for n, k in enumerate(kept)}
    both = [n for n, pair in enumerate(bank.pairs) if set(pair) <= set(kept)]
    left = replace(
        bank,
        lines=tuple(bank.lines[k] for k in kept),
        changes=tuple(bank.changes[k] for k in kept),
        pairs=tuple((place[a], place[b]) for a, b in (bank.pairs[n] for n in both)),
        interactions=bank.interactions[both],
    )
    return left, tuple(name for name in effects if name not in moves)
