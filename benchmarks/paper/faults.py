"""What is lost when things go wrong? Nothing that was recorded, and a sentence says what happened.

Every fault is provoked in a whole `s2r check` of its own, on the tests' toy backend (a point that glides
to its speed, with habits: it dies, hangs, raises, or gives NaN). Then it is counted: rollouts in the
journal when the process was gone, how many of them are the same bytes after `--resume`, and whether the
resumed certificate is the undisturbed one, bit for bit. ::

    python -m benchmarks.paper.faults          # about 5 minutes of one core; Linux

As root a folder cannot be made unwritable by its mode, and so a read-only file system is mounted for it,
and a small one for the full disk; without the right to mount, the mode and a limit on the size of files
(RLIMIT_FSIZE) stand in, and the table says so.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import re
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from benchmarks.machine import describe

ROOT = Path(__file__).parents[2]

RESULTS = Path(__file__).parent / "results" / "faults.json"
SPEC = """\
signal vx {m/s}
param  vd {m/s} in [-0.2, 0.3]
require walking: always[0.5 s, 1.5 s] (abs(vx - vd) <= 0.1 {m/s})
certify walking: delta = 1e-3, epsilon = 0.05, B = 0.5, R = 0.02, kernel = rbf(0.2 {m/s}), fall = -0.5
"""


@dataclass(frozen=True)
class Row:
    """What one fault did.

    Attributes:
        fault: in words.
        exit_code: of the disturbed process; negative for a signal.
        sentence: what it said.
        before: rollouts in the journal when it was gone.
        kept: of them, the same bytes after the run was resumed.
        after: rollouts in the journal then.
        same: whether the resumed certificate is the undisturbed one; None where that cannot be.
    """

    fault: str
    exit_code: int
    sentence: str
    before: int
    kept: int
    after: int
    same: bool | None

    @property
    def lost(self) -> int:
        return self.before - self.kept


class Bench:
    """Runs `s2r check` in one folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        (folder / "spec.stl").write_text(SPEC)
        plugins = os.pathsep.join([str(ROOT), str(ROOT / "backends"), str(ROOT / "tests" / "plugin")])
        self.environment = os.environ | {"PYTHONPATH": plugins, "COLUMNS": "200"}

    def command(self, backend: str, *words: object) -> list[str]:
        return [
            *(
                sys.executable,
                "-m",
                "s2r_spec",
                "check",
                "spec.stl",
                "-b",
                backend,
                "--workers",
                "1",
                "--quiet",
            ),
            *map(str, words),
        ]

    def start(self, backend: str, *words: object, **more: Any) -> subprocess.Popen[str]:
        return subprocess.Popen(
            self.command(backend, *words),
            cwd=self.folder,
            env=self.environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            **more,
        )

    def finish(self, backend: str, *words: object, **more: Any) -> tuple[int, str, dict[str, Any] | None]:
        """Run to the end; return exit code, what it said, and the certificate if there is one."""
        process = self.start(backend, *words, "--json", **more)
        out, said = process.communicate(timeout=600)
        found = json.loads(out) if out.strip() else {}
        return process.returncode, said, certificate(found)


def certificate(found: dict[str, Any]) -> dict[str, Any] | None:
    """Return what a result says of the system, without clocks and folders."""
    if "results" not in found:
        return None
    one = dict(found["results"][0])
    for key in ("seconds", "folder", "replay"):
        one.pop(key, None)
    one["lowest"] = {key: value for key, value in one["lowest"].items() if key != "seconds"}
    return one


def lines(run: Path) -> list[bytes]:
    """Return the whole lines of a journal but the first, which says what the run is."""
    place = run / "walking" / "journal.jsonl"
    whole, newline, _ = (place.read_bytes() if place.exists() else b"").rpartition(b"\n")
    return whole.split(b"\n")[1:] if newline else []


def sentence(said: str) -> str:
    """Return the last thing that was said, without what differs from run to run."""
    text = said.strip().splitlines()[-1] if said.strip() else ""
    return re.sub(r"/\S*/(?=\w)", "…/", text)


def resumed(bench: Bench, fault: str, run: str, backend: str, code: int, said: str, whole: Any) -> Row:
    """Resume a run that was disturbed, and compare."""
    before = lines(bench.folder / run)
    _, _, now = bench.finish(backend, "--resume", run)
    after = lines(bench.folder / run)
    kept = sum(old == new for old, new in zip(before, after, strict=False))
    return Row(fault, code, sentence(said), len(before), kept, len(after), now == whole)


def killed(bench: Bench, whole: Any, total: int, times: int, who: str) -> Iterator[Row]:
    """Kill the process with SIGKILL, each time somewhere else."""
    places = random.Random(0)
    for which in range(times):
        run = f"killed-{which}"
        at, delay = places.randrange(total), places.uniform(0, 0.03)
        process = bench.start("toy:slow", "--run", run)
        while len(lines(bench.folder / run)) < at and process.poll() is None:
            time.sleep(0.001)
        time.sleep(delay)
        process.kill()
        _, said = process.communicate()
        yield resumed(
            bench,
            f"{who}, after {at} rollouts and {1000 * delay:.0f} ms",
            run,
            "toy:slow",
            process.returncode,
            said,
            whole,
        )


@contextmanager
def mounted(place: Path, options: str) -> Iterator[bool]:
    """Mount a file system of its own at a folder, if that is allowed."""
    place.mkdir(exist_ok=True)
    done = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(place)], capture_output=True, check=False
    )
    try:
        yield done.returncode == 0
    finally:
        if done.returncode == 0:
            subprocess.run(["umount", str(place)], check=True)


def full_disk(bench: Bench, whole: Any) -> Row:
    """Fill the disk in the middle of a run, make room, go on."""
    place = bench.folder / "disk"
    with mounted(place, "size=200k") as small:
        if small:
            code, said, _ = bench.finish("toy:slow", "--run", "disk/run")
            subprocess.run(["mount", "-o", "remount,size=50m", str(place)], check=True)
            return resumed(
                bench, "disk full (a file system of 200 KiB)", "disk/run", "toy:slow", code, said, whole
            )
    code, said, _ = bench.finish("toy:slow", "--run", "disk/run", preexec_fn=_small_files)
    return resumed(bench, "disk full (files of at most 20 KiB)", "disk/run", "toy:slow", code, said, whole)


def _small_files() -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))


def read_only(bench: Bench, whole: Any) -> Iterator[Row]:
    """Begin a run where nothing can be written, and resume one there."""
    place = bench.folder / "readonly"
    with mounted(place, "size=50m") as own:
        bench.finish("toy:slow", "--run", "readonly/old", "--budget", 40)
        before = lines(place / "old")
        how = "a read-only file system" if own else "folder of mode 0555"
        if own:
            subprocess.run(["mount", "-o", "remount,ro", str(place)], check=True)
        else:
            for folder in (place / "old" / "walking" / "traces", place / "old" / "walking", place):
                folder.chmod(0o555)
        code, said, _ = bench.finish("toy:slow", "--run", "readonly/new")
        yield Row(f"{how}, new run", code, sentence(said), 0, 0, 0, None)
        code, said, _ = bench.finish("toy:slow", "--resume", "readonly/old")
        still = lines(place / "old")
        kept = sum(old == new for old, new in zip(before, still, strict=False))
        yield Row(f"{how}, resumed run", code, sentence(said), len(before), kept, len(still), None)
        if own:
            subprocess.run(["mount", "-o", "remount,rw", str(place)], check=True)
        else:
            for folder in (place, place / "old" / "walking", place / "old" / "walking" / "traces"):
                folder.chmod(0o755)


def worker_killed(bench: Bench, whole: Any) -> Row:
    """Kill the process that runs the rollouts, not the one that searches."""
    process = bench.start("toy:slow", "--run", "orphan", "--json")
    while len(lines(bench.folder / "orphan")) < 20:
        time.sleep(0.001)
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    threads = Path(f"/proc/{process.pid}/task").iterdir()
    children += [pid for each in threads for pid in (each / "children").read_text().split()]
    before = lines(bench.folder / "orphan")
    for pid in set(children):
        os.kill(int(pid), signal.SIGKILL)
    out, said = process.communicate()
    after = lines(bench.folder / "orphan")
    kept = sum(old == new for old, new in zip(before, after, strict=False))
    words = sentence(said) or "nothing: the rollout was run again by a new worker"
    same = certificate(json.loads(out)) == whole
    return Row("kill -9 of a worker", process.returncode, words, len(before), kept, len(after), same)


def misbehaves(bench: Bench, fault: str, backend: str, *words: object) -> Row:
    """Run a backend with a bad habit, and resume: that must come to the same."""
    run = backend.replace(":", "-")
    process = bench.start(backend, "--run", run, *words, "--json")
    out, said = process.communicate(timeout=600)
    first = certificate(json.loads(out)) if out.strip() else None
    before = lines(bench.folder / run)
    _, _, again = bench.finish(backend, "--resume", run, *words)
    after = lines(bench.folder / run)
    kept = sum(old == new for old, new in zip(before, after, strict=False))
    same = first == again if first is not None else None
    return Row(fault, process.returncode, sentence(said), len(before), kept, len(after), same)


def loud(bench: Bench, fault: str, backend: str, *words: object) -> Row:
    """As :func:`misbehaves`, with the crash's own sentence, which ``--quiet`` leaves out."""
    row = misbehaves(bench, fault, backend, *words)
    command = bench.command(backend, "--run", f"{backend.replace(':', '-')}-loud", *words)
    command.remove("--quiet")
    said = subprocess.run(
        command, cwd=bench.folder, env=bench.environment, capture_output=True, text=True, check=False
    ).stderr
    crash = next(line for line in said.splitlines() if "it counts as" in line)
    return Row(**asdict(row) | {"sentence": re.sub(r"at vd = \S+ m/s", "at vd = … m/s", crash)})


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--output", type=Path, default=RESULTS)
    options = parser.parse_args()
    rows: list[Row] = []

    def say(row: Row) -> None:
        rows.append(row)
        same = {True: "same certificate", False: "ANOTHER CERTIFICATE", None: "no certificate"}[row.same]
        print(
            f"{row.fault:48} exit {row.exit_code:3d}, {row.before:3d} recorded, lost {row.lost}, "
            f"then {row.after:3d}, {same}; {row.sentence or '(says nothing: it was killed)'}",
            flush=True,
        )

    with tempfile.TemporaryDirectory() as name:
        bench = Bench(Path(name))
        _, _, whole = bench.finish("toy:slow", "--run", "whole")
        assert whole is not None
        total = len(lines(bench.folder / "whole"))
        print(f"undisturbed: {total} rollouts")
        for row in killed(bench, whole, total, options.kills, "kill -9"):
            say(row)
        say(worker_killed(bench, whole))
        say(full_disk(bench, whole))
        for row in read_only(bench, whole):
            say(row)
        say(loud(bench, "the backend kills its worker at some tests", "toy:die"))
        say(loud(bench, "the backend hangs at some tests", "toy:hang", "--timeout", 0.5))
        say(misbehaves(bench, "the backend gives NaN at some tests", "toy:nan"))
        say(misbehaves(bench, "the backend raises", "toy:raise"))
    record = {
        "machine": describe(),
        "undisturbed_rollouts": total,
        "rows": [asdict(row) | {"lost": row.lost} for row in rows],
        "lost": sum(row.lost for row in rows),
        "same": sum(row.same is True for row in rows),
        "another": sum(row.same is False for row in rows),
    }
    options.output.write_text(json.dumps(record, indent=1, ensure_ascii=False) + "\n")
    print(f"lost: {record['lost']} rollouts; another certificate: {record['another']} of {len(rows)} faults")
    return int(bool(record["lost"] or record["another"]))


if __name__ == "__main__":
    sys.exit(main())
