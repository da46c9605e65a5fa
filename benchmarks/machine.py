"""Names the machine and the versions that a result was made with."""

from __future__ import annotations

import os
import platform
from datetime import date
from importlib.metadata import version
from pathlib import Path

from s2r_spec.base import distribution


def processor() -> str:
    """Return the name of the processor."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    named = (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    return next(named, platform.processor())


def describe(*packages: str) -> dict[str, object]:
    """Return processor, cores, Python and package versions, and the day."""
    return {
        "date": date.today().isoformat(),
        "processor": processor(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        "versions": {"s2r": distribution.version()} | {name: version(name) for name in packages},
    }
