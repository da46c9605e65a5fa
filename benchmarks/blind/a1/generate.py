"""Make a sealed set of A1 cases: a twin's rollouts in public/<id>/, what ails it in sealed/<id>.json.

Run: OMP_NUM_THREADS=1 python -m benchmarks.blind.a1.generate --cases 200 --out FOLDER [--seed N] [--workers 2]

FOLDER/public/<id>/ is a folder of recorded rollouts with its spec, for ``s2r``;
FOLDER/sealed/<id>.json is its label, and FOLDER/sealed/<id>/ further rollouts
for scoring. All cases have the same tests, so a diagnosis of one keeps what the next
needs of the simulator. Without --seed nobody, not even the author of this file, knows the
set before it is opened. Samples are stored as 32-bit floats, times as 64-bit.
Nothing here was measured on a robot.
"""

from __future__ import annotations

import argparse
import csv
import json
import secrets
import shutil
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from benchmarks.blind.a1.cases import MIX, SPEC, Case, CaseKind, make_case, tests
from s2r_spec.trace import Trace

ROLLOUTS = 30
HELD_OUT = 20


def plan(cases: int, rng: np.random.Generator) -> list[CaseKind]:
    """Return the kind of every case: the mix, rounded to whole cases, in random order."""
    shares = np.array(list(MIX.values())) * cases
    counts = np.floor(shares).astype(int)
    for place in np.argsort(counts - shares)[: cases - counts.sum()]:
        counts[place] += 1
    kinds = [kind for kind, count in zip(MIX, counts.tolist(), strict=True) for _ in range(count)]
    return [kinds[place] for place in rng.permutation(cases)]


def write_trace(trace: Trace, path: Path) -> None:
    """Write a trace in the project's npz format, samples as 32-bit floats, packed."""
    notes = json.dumps({"units": dict(trace.units), "meta": dict(trace.meta)})
    samples = {name: values.astype(np.float32) for name, values in trace.channels.items()}
    np.savez_compressed(path, **{"t": trace.times, "s2r.json": np.array(notes)}, **samples)


def write_folder(folder: Path, rollouts: Sequence[tuple[dict[str, float], Trace]]) -> None:
    """Write rollouts as a folder that ``log:FOLDER`` reads."""
    folder.mkdir(parents=True)
    names = [f"run-{number:02d}" for number in range(len(rollouts))]
    for name, (_, trace) in zip(names, rollouts, strict=True):
        write_trace(trace, folder / f"{name}.npz")
    with (folder / "rollouts.csv").open("w", newline="") as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(["id", *(f"{name} [m/s]" for name in rollouts[0][0])])
        table.writerows([name, *params.values()] for name, (params, _) in zip(names, rollouts, strict=True))


def write_case(out: Path, name: str, case: Case) -> None:
    """Write what may be seen under public/, and what may not under sealed/."""
    folder = out / "public" / name
    write_folder(folder, case.rollouts)
    shutil.copyfile(SPEC, folder / "spec.stl")
    sealed = out / "sealed"
    sealed.mkdir(exist_ok=True)
    if case.held_out:
        write_folder(sealed / name, case.held_out)
    (sealed / f"{name}.json").write_text(json.dumps({"id": name} | case.label, indent=1) + "\n")


def one(
    out: Path, seed: int, number: int, kind: CaseKind, commands: Sequence[float], held_out: int
) -> tuple[int, int]:
    """Make and write one case; return how many rollouts it has, and how many of them fell."""
    rng = np.random.default_rng([seed, number])
    name = rng.bytes(6).hex()
    case = make_case(rng, kind, len(commands), held_out, commands)
    write_case(out, name, case)
    runs = case.rollouts + case.held_out
    return len(runs), sum(trace.failure is not None for _, trace in runs)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, required=True)
    parser.add_argument("--seed", type=int, help="seed of a set that can be made again; random by default")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--rollouts", type=int, default=ROLLOUTS, help="of every case, at the same tests")
    parser.add_argument("--held-out", type=int, default=HELD_OUT, help="rollouts for scoring alone")
    asked = parser.parse_args()
    if asked.out.exists() and any(asked.out.iterdir()):
        parser.error(f"{asked.out} is not empty; give a new folder")
    seed = secrets.randbits(128) if asked.seed is None else asked.seed
    rng = np.random.default_rng([seed, 10**9])
    kinds = plan(asked.cases, rng)
    commands = tests(rng, asked.rollouts)
    start = time.monotonic()
    rows = [(asked.out, seed, number, kind, commands, asked.held_out) for number, kind in enumerate(kinds)]
    with ProcessPoolExecutor(asked.workers, mp_context=get_context("spawn")) as pool:
        made = list(pool.map(one, *zip(*rows, strict=True)))
    runs, falls = np.sum(made, axis=0).tolist()
    print(
        f"{asked.cases} cases, {runs} rollouts, {falls} of them ended in a fall, "
        f"{time.monotonic() - start:.0f} s with {asked.workers} worker(s)"
    )


if __name__ == "__main__":
    main()
