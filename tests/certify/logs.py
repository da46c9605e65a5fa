"""Folders of recorded rollouts, made by running a backend: a twin's log."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import s2r_spec as s2r


def record_from(name: str, tests: Sequence[float], folder: Path, *, seed: int = 3000, **fixed: float) -> str:
    """Run the backend at each vd [m/s] once, with a seed of its own, and return the log's backend name."""
    folder.mkdir()
    machine = s2r.load_backend(name)
    units = {parameter.name: parameter.unit for parameter in machine.parameters}
    rows = [",".join(["id", *(f"{key} [{units[key]}]" for key in ("vd", *fixed))])]
    for number, vd in enumerate(tests):
        trace = machine.rollout({"vd": vd, **fixed}, seed + number)
        s2r.write_trace(trace, folder / f"run{number:04d}.npz")
        rows.append(",".join([f"run{number:04d}", repr(vd), *(repr(value) for value in fixed.values())]))
    (folder / "rollouts.csv").write_text("\n".join(rows) + "\n")
    return f"log:{folder}"
