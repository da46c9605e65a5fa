"""What the commands share: errors to sentences, and where a run lives."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import typer

from s2r_spec.errors import S2RError


@contextmanager
def sentences(as_json: bool = False) -> Iterator[None]:
    """Turn s2r's own errors into one sentence on stderr (and one object on stdout), and the exit code."""
    try:
        yield
    except S2RError as error:
        print(f"error: {error}" if not str(error).startswith("error") else str(error), file=sys.stderr)
        if as_json:
            print(json.dumps({"schema": "s2r.error/1", "exit_code": error.exit_code, "error": str(error)}))
        raise typer.Exit(error.exit_code) from error


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
