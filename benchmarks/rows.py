"""Rows of a benchmark, one file each: a second call goes on where the first was stopped."""

from __future__ import annotations

import json
from argparse import ArgumentParser
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor
from pathlib import Path
from typing import Any, TypeVar

Job = TypeVar("Job")


def add_arguments(parser: ArgumentParser) -> None:
    """Add the arguments of a benchmark with rows."""
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--rows", type=Path, help="folder for the row of each machine; a second call resumes")
    parser.add_argument("--write", action="store_true", help="keep the result in the folder of results")


def resumed(
    make: Callable[[Job], dict[str, Any]],
    jobs: Mapping[str, Job],
    pool: Executor,
    folder: Path | None = None,
) -> Iterator[dict[str, Any]]:
    """Yield the row of every job, in their order.

    Args:
        make: from a job to its row.
        jobs: name of the file → job.
        pool: runs ``make``.
        folder: of the files; nothing is kept without one.
    """
    paths = {name: folder / f"{name}.json" for name in jobs} if folder else {}
    pending = {
        name: pool.submit(make, job)
        for name, job in jobs.items()
        if not (name in paths and paths[name].exists())
    }
    for name in jobs:
        if name not in pending:
            yield json.loads(paths[name].read_text())
            continue
        row = pending[name].result()
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
            part = paths[name].with_suffix(".part")
            part.write_text(json.dumps(row))
            part.rename(paths[name])
        yield row
