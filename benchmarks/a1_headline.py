"""Does the certificate of `a1` hold the truth? A twin behind the robot's wire, at the places lab and ramp.

    OMP_NUM_THREADS=1 python benchmarks/a1_headline.py --keep FOLDER [--rollouts 200] [--write]

Three parts at each place, each kept in FOLDER as it is found, so that a run that was ended goes on:

    same    rollouts of `a1:…,clock=lockstep` over sockets, and the same in one process: ρ must be equal
    certify the user's command, its JSON as it came
    truth   mean ρ of many rollouts a test in one process: first few at all tests, then as many as were asked for at
            those that could be the worst, by the estimate or by the true velocity

Data: ρ of rollout i at test v, once of vx as recorded (onboard, the robot's own estimate) and once of the twin's true
forward velocity. Estimate: the mean at each test, its standard error, and the least mean over the tests. Between two
tests that are not in the list nothing is measured. The certified interval must hold the least onboard mean; where the
least true mean lies says what the assumption "vx of a1 is its own estimate" costs. Everything here is a twin, no robot.

Units: ρ and vd [m/s], times [s].
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import json
import math
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from functools import cache, partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import s2r_spec as s2r
from s2r_a1.backend import A1Backend
from s2r_a1.pilot import Pilot
from s2r_a1.twin import Twin, TwinSettings
from s2r_sim.settings import Settings
from s2r_spec.backend import Coming
from s2r_spec.errors import BackendError
from s2r_spec.rollouts.seeds import rollout_seed

sys.path.insert(0, str(Path(__file__).parent))
from a1_in_process import Line, rollout
from machine import describe

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results"
SPEC = "specs/a1_velocity.stl"
TESTS = (-0.2, -0.1, 0.0, 0.1, 0.2, 0.3)
"""A budget [m/s]: six values of vd, with both ends of the test space; the certificate's worst test is added."""
SEED = 43_000
"""A definition: of the truth's rollouts, which share none with those of the command (seed 0)."""
CHAIN = 10
"""A budget: rollouts that one twin walks without lying down, as it does for the command. Twice as many take 4 % less
time, and are drawn apart by fewer stands."""
ERRORS = 3.0
"""A level: standard errors within which a test could be the worst one; twice as many send more tests to the end."""


class Walk(NamedTuple):
    """One rollout of the truth, as it is kept: a line of JSON."""

    place: str
    vd: float
    number: int
    onboard: float
    true: float
    ended: str | None
    yaw: float
    seconds: float


@cache
def spec() -> s2r.Spec:
    """Return the specification."""
    return s2r.load_spec(ROOT / SPEC)


@cache
def pilot() -> Pilot:
    """Return this process's pilot, which has practised."""
    made = Pilot(Settings())
    made.practise()
    return made


def digest() -> str:
    """Return what changes with anything that the truth is made by."""
    found = hashlib.sha256()
    sources = [
        ROOT / SPEC,
        Path(__file__).with_name("a1_in_process.py"),
        *sorted((ROOT / "backends" / "s2r_a1").rglob("*.py")),
        *sorted((ROOT / "backends" / "s2r_sim").rglob("*.py")),
    ]
    for path in sources:
        found.update(path.read_bytes())
    return found.hexdigest()[:12]


def rho(trace: s2r.Trace, vd: float) -> float:
    """Return ρ of a rollout; of one that the robot ended, the value that the specification declares."""
    return float(spec().robustness(trace, params={"vd": vd})["walking"])


def seconds() -> float:
    """Return the length of a rollout."""
    return float(spec().horizon("walking"))


# The truth.


def chained(place: str, vd: float, chain: int, count: int, file: Path) -> None:
    """Walk a chain of rollouts that one twin takes without lying down, and keep each as a line."""
    line, twin, fresh = None, None, 0
    pilot()  # compiles, which is no part of a rollout's time
    for i in range(count):
        if line is None or twin is None:
            twin = Twin(TwinSettings(place, seed=SEED + 100 * chain + fresh))
            line, fresh = Line(twin), fresh + 1
        began = time.process_time()
        walked = rollout(line, pilot(), vd, rollout_seed(SEED, chain, i), seconds())
        if walked.void:
            raise BackendError(f"a rollout in lock step was void: {walked.void}, vd = {vd:g}, {place}")
        found = Walk(
            place,
            vd,
            CHAIN * chain + i,
            rho(walked.onboard, vd),
            rho(walked.true, vd),
            walked.onboard.failure,
            float(twin.truth().rpy[2]),
            time.process_time() - began,
        )
        with file.open("a", encoding="utf-8") as lines:
            lines.write(json.dumps(found._asdict()) + "\n")
        if line.change.state != "STAND":  # whatever ended it, the next one is walked by another twin
            line = None


def kept(file: Path) -> dict[tuple[str, float, int], Walk]:
    """Return the rollouts that are on disk; one that was written halfway is walked again."""
    found = {}
    for text in file.read_text(encoding="utf-8").splitlines() if file.exists() else ():
        with contextlib.suppress(ValueError, TypeError):
            walk = Walk(**json.loads(text))
            found[walk.place, walk.vd, walk.number] = walk
    return found


def walked(place: str, tests: list[float], count: int, file: Path, workers: int) -> None:
    """Have the first ``count`` rollouts at these tests on disk."""
    have = kept(file)
    wanted = []
    for chain in range(math.ceil(count / CHAIN)):
        most = min(CHAIN, count - CHAIN * chain)
        wanted += [
            (vd, chain, most)
            for vd in tests
            if any((place, vd, CHAIN * chain + i) not in have for i in range(most))
        ]
    with ProcessPoolExecutor(workers, get_context("spawn")) as pool:
        begun = [pool.submit(chained, place, vd, chain, most, file) for vd, chain, most in wanted]
        for n, done in enumerate(begun, 1):
            done.result()
            print(f"\r  {place}: {n} of {len(begun)} chains", end="", flush=True, file=sys.stderr)
    if begun:
        print(file=sys.stderr)


def row(walks: list[Walk], vd: float) -> dict[str, Any]:
    """Return what is known of a test."""
    found: dict[str, Any] = {"vd": vd, "rollouts": len(walks)}
    for name in ("onboard", "true"):
        values = np.array([getattr(walk, name) for walk in walks])
        found[name] = {
            "mean": float(values.mean()),
            "standard_error": float(values.std(ddof=1) / math.sqrt(len(values))),
            "std": float(values.std(ddof=1)),
            "lowest": float(values.min()),
        }
    found["ended"] = sum(walk.ended is not None for walk in walks)
    found["largest_yaw"] = max(abs(walk.yaw) for walk in walks)
    return found


def rows(place: str, tests: list[float], file: Path) -> list[dict[str, Any]]:
    """Return what is known of each test."""
    have = sorted(kept(file).values(), key=lambda walk: walk.number)
    return [row([walk for walk in have if (walk.place, walk.vd) == (place, vd)], vd) for vd in tests]


def could_be_worst(table: list[dict[str, Any]]) -> list[float]:
    """Return the tests whose mean may be the least, of either velocity."""
    found = set()
    for name in ("onboard", "true"):
        least = min(one[name]["mean"] + ERRORS * one[name]["standard_error"] for one in table)
        found |= {
            one["vd"] for one in table if one[name]["mean"] - ERRORS * one[name]["standard_error"] <= least
        }
    return sorted(found)


def truth(place: str, tests: list[float], options: argparse.Namespace, file: Path) -> list[dict[str, Any]]:
    """Return mean ρ at all tests: of few rollouts, and of all that were asked for where the worst may be."""
    walked(place, tests, min(options.first, options.rollouts), file, options.workers)
    for _ in tests:  # more rollouts may make another test the worst one
        table = rows(place, tests, file)
        short = {one["vd"] for one in table if one["rollouts"] < options.rollouts}
        needed = [vd for vd in could_be_worst(table) if vd in short]
        if not needed:
            break
        walked(place, needed, options.rollouts, file, options.workers)
    return rows(place, tests, file)


# Over sockets.


class Nobody:
    """An operator (:class:`s2r_spec.backend.Operator`) of whom nothing is asked: ``operator=auto``."""

    def say(self, text: str) -> None:
        """Do nothing."""

    def type_word(self, question: str, word: str) -> None:
        """Refuse."""
        raise AssertionError(question)

    def choose(self, question: str, answers: Mapping[str, str]) -> str:
        """Refuse."""
        raise AssertionError(question)


@contextlib.contextmanager
def served(place: str, seed: int, port: int = 0) -> Iterator[int]:
    """Serve a lock-step twin from a process of its own, and give its port; its guard is ended with it."""
    command = [sys.executable, "-m", "s2r_a1.twin", "--place", place, "--clock", "lockstep"]
    command += ["--seed", str(seed), "--port", str(port)]
    # In a session of its own: a Ctrl-C is for the command that walks it, and not for the twin.
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True)
    assert process.stdout is not None
    try:
        line = process.stdout.readline()
        if "127.0.0.1:" not in line:
            raise SystemExit(f"the twin does not start; is the UDP port {port} free?")
        port = int(line.partition("127.0.0.1:")[2].partition(",")[0])
        yield port
        guard = [sys.executable, "-m", "s2r_a1.guard", "stop", "--port", str(port)]
        subprocess.run(guard, capture_output=True, check=False)
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait(20.0)
        process.stdout.close()


def options_of(port: int) -> str:
    """Return the robot as the command line has it, after ``a1:``."""
    return f"host=127.0.0.1,port={port},velocity=onboard,operator=auto,clock=lockstep"


def same(place: str, count: int, tests: list[float], folder: Path) -> dict[str, Any]:
    """Walk some tests over sockets, and the same in this process."""
    ends = [tests[-1], tests[0], *tests[1:-1]]
    plan = [(ends[i % len(ends)], rollout_seed(SEED, 999, i)) for i in range(count)]
    over, wall = [], []
    with served(place, SEED) as port:
        backend = A1Backend(options_of(port)).with_duration(seconds()).keeping(str(folder / "same" / place))
        backend.prepare()
        attended = backend.attendance(Nobody())
        try:
            attended.begin(Coming(count))
            for vd, seed in plan:
                attended.before({"vd": vd})
                began = time.monotonic()
                trace = backend.rollout({"vd": vd}, seed)
                wall.append(time.monotonic() - began)
                attended.after(trace)
                over.append(trace)
        finally:
            attended.end()
    line = Line(Twin(TwinSettings(place, seed=SEED)))
    apart, ours, spent = [], [], []
    for (vd, seed), trace in zip(plan, over, strict=True):
        began = time.process_time()
        own = rollout(line, pilot(), vd, seed, seconds()).onboard
        spent.append(time.process_time() - began)
        ours.append(own)
        alike = len(own) == len(trace) and own.failure == trace.failure
        apart.append(float(np.abs(own["vx"] - trace["vx"]).max()) if alike else math.inf)
    return {
        "rollouts": count,
        "tests": [vd for vd, _ in plan],
        "rho_over_sockets": [rho(trace, vd) for (vd, _), trace in zip(plan, over, strict=True)],
        "rho_in_one_process": [rho(trace, vd) for (vd, _), trace in zip(plan, ours, strict=True)],
        "largest_difference_of_vx": max(apart),
        "seconds_over_sockets": float(np.median(wall)),
        "seconds_in_one_process": float(np.median(spent)),
    }


def certified(place: str, budget: int, folder: Path) -> dict[str, Any]:
    """Run the user's command against a twin, or go on with a run of it, and return what it said."""
    run = folder / f"certify-{place}-{budget}"
    port_file = folder / f"port-{place}"
    if not port_file.exists():
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind(("127.0.0.1", 0))
            port_file.write_text(str(free.getsockname()[1]))
    with served(place, 0, int(port_file.read_text())) as port:
        real = f"a1:{options_of(port)}"
        words = ["certify", SPEC, "--sim", "sim", "--real", real, "--budget", str(budget)]
        began = time.monotonic()
        done = subprocess.run(
            [sys.executable, "-m", "s2r_spec", *words, "--resume" if run.exists() else "--run", str(run), "--json"],
            cwd=ROOT,
            stdout=subprocess.PIPE,
            text=True,
            check=False,
        )  # fmt: skip
        took = time.monotonic() - began
    result = json.loads(done.stdout.replace(str(folder), "…") or "{}")
    if not result.get(
        "promise"
    ):  # an error, or a certificate that is refused: too many void rollouts, for one
        why = result.get("reason") or result.get("error") or "see above"
        raise SystemExit(
            f"s2r certify gives no certificate at {place} (exit code {done.returncode}): {why}; "
            f"to begin that run anew, remove {run}"
        )
    return {
        "command": " ".join(["s2r", *words]),
        "exit_code": done.returncode,
        "seconds": round(took, 1),
        "result": result,
    }


# What is printed.


def once(path: Path, make: Any) -> Any:
    """Return what is in a file of JSON, made if it is not there."""
    if not path.exists():
        found = make()
        path.write_text(json.dumps(found, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    return json.loads(path.read_text(encoding="utf-8"))


def worst_of(table: list[dict[str, Any]], name: str) -> dict[str, Any]:
    """Return the test with the least mean."""
    one = min(table, key=lambda row: row[name]["mean"])
    return {"vd": one["vd"], "rollouts": one["rollouts"], **one[name]}


def judged(place: str, options: argparse.Namespace, folder: Path, lines: Path) -> dict[str, Any]:
    """Return everything about a place."""
    found: dict[str, Any] = {"place": f"twin {place}"}
    tests = sorted(options.tests)
    if options.same:
        found["same"] = once(
            folder / f"same-{place}-{options.same}.json", partial(same, place, options.same, tests, folder)
        )
    if options.budget:
        path = folder / f"certify-{place}-{options.budget}.json"
        found["certify"] = once(path, partial(certified, place, options.budget, folder))
        promise = found["certify"]["result"]["promise"]
        tests = sorted({*tests, round(promise["worst"]["vd"], 6)})
    found["truth"] = table = truth(place, tests, options, lines)
    onboard, true = worst_of(table, "onboard"), worst_of(table, "true")
    found["worst_onboard"], found["worst_true"] = onboard, true
    found["cost_of_the_assumption"] = onboard["mean"] - true["mean"]
    walks = [walk for walk in kept(lines).values() if walk.place == place]
    found["seconds_of_a_rollout"] = float(np.median([walk.seconds for walk in walks]))
    found["seconds_of_the_truth"] = sum(walk.seconds for walk in walks)
    if options.budget:
        found["holds"] = promise["lower"] <= onboard["mean"] <= promise["upper"]
        found["holds_true"] = promise["lower"] <= true["mean"] <= promise["upper"]
    return found


def text_of(found: dict[str, Any]) -> str:
    """Return what a person reads of a place."""
    out = [f"{found['place']}, no robot"]
    if "same" in found:
        one = found["same"]
        pairs = zip(one["rho_over_sockets"], one["rho_in_one_process"], strict=True)
        out += [
            f"  {one['rollouts']} rollouts over sockets and in one process: vx differs by at most "
            f"{one['largest_difference_of_vx']:.1g} m/s; "
            + ", ".join(f"{over:+.4f} and {ours:+.4f}" for over, ours in pairs),
            f"  one takes {one['seconds_over_sockets']:.1f} s over sockets (wall), "
            f"{one['seconds_in_one_process']:.1f} s in one process (processor)",
        ]
    out.append("  mean ρ [m/s]:   vd   rollouts       onboard              true vx        ended  largest yaw")
    for row in found["truth"]:
        means = "   ".join(
            f"{row[name]['mean']:+.4f} ± {row[name]['standard_error']:.4f}" for name in ("onboard", "true")
        )
        out.append(
            f"           {row['vd']:+9.4f} {row['rollouts']:8d}   {means} {row['ended']:6d} {row['largest_yaw']:10.3f}"
        )
    onboard, true = found["worst_onboard"], found["worst_true"]
    out += [
        f"  worst mean of ρ as recorded (onboard): {onboard['mean']:+.4f} ± {onboard['standard_error']:.4f} m/s at "
        f"vd = {onboard['vd']:g}, {onboard['rollouts']} rollouts",
        f"  the same of the true vx:               {true['mean']:+.4f} ± {true['standard_error']:.4f} m/s at "
        f"vd = {true['vd']:g}, {true['rollouts']} rollouts",
        f'  "vx of a1 is its own estimate" costs   {found["cost_of_the_assumption"]:+.4f} m/s: '
        f"the estimate makes the machine look {'better' if found['cost_of_the_assumption'] > 0 else 'worse'}",
    ]
    if "certify" in found:
        result, promise = found["certify"]["result"], found["certify"]["result"]["promise"]
        out += [
            f"  {found['certify']['command']}   (lock step, {found['certify']['seconds'] / 60:.0f} min)",
            f"  {result['verdict']}: worst expected ρ in [{promise['lower']:+.4f}, {promise['upper']:+.4f}] m/s with "
            f"probability ≥ 1 − {promise['delta']:g}; worst test vd = {promise['worst']['vd']:.4f} m/s",
            f"  the interval {'HOLDS' if found['holds'] else 'DOES NOT HOLD'} the worst mean as recorded; "
            f"it {'holds' if found['holds_true'] else 'does not hold'} that of the true vx",
        ]
    out.append(
        f"  processor time of a rollout: {found['seconds_of_a_rollout']:.2f} s, of the truth: "
        f"{found['seconds_of_the_truth'] / 60:.0f} min"
    )
    return "\n".join(out)


def main() -> int:
    """Run what is missing, print, and write."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add(
        "--keep",
        type=Path,
        required=True,
        metavar="FOLDER",
        help="folder of the results so far; the run continues from them",
    )
    add("--places", nargs="+", default=["lab", "ramp"])
    add("--tests", nargs="+", type=float, default=list(TESTS), help="values of vd [m/s]")
    add("--rollouts", type=int, default=200, help="rollouts at each test that may be the worst")
    add("--first", type=int, default=20, help="rollouts at every test, to find the worst ones")
    add("--budget", type=int, default=100, help="budget of s2r certify; 0 leaves it out")
    add("--same", type=int, default=3, help="rollouts over sockets and in one process; 0 leaves them out")
    add("--workers", type=int, default=os.cpu_count() or 1)
    add("--write", action="store_true", help="write benchmarks/results/a1_headline.json and .txt")
    options = parser.parse_args()  # fmt: skip
    folder = (options.keep / digest()).resolve()
    folder.mkdir(parents=True, exist_ok=True)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that no twin is left behind
    began = time.monotonic()
    places = []
    for place in options.places:
        places.append(judged(place, options, folder, folder / "truth.jsonl"))
        print(text_of(places[-1]), flush=True)
    spent = sum(one["seconds_of_the_truth"] for one in places)
    certify = sum(one.get("certify", {}).get("seconds", 0.0) for one in places)
    took = (
        f"{options.workers} processes; the truth took {spent / 60:.0f} min of processor time, so "
        f"{spent / 60 / options.workers:.0f} min on {options.workers} cores; certify {certify / 60:.0f} min; "
        f"this call {(time.monotonic() - began) / 60:.0f} min"
    )
    print(took)
    if options.write:
        machine = describe("mujoco", "pin", "piqp", "torch", "gpytorch")
        record = {"machine": machine, "spec": SPEC, "clock": "lockstep", "took": took, "places": places}
        json_text = json.dumps(record, indent=1, ensure_ascii=False)
        (RESULTS / "a1_headline.json").write_text(json_text + "\n", encoding="utf-8")
        head = (
            f"{machine['processor']}, {machine['cores']} cores, Python {machine['python']}, {machine['date']}"
        )
        text = "\n".join([head, *map(text_of, places), took])
        (RESULTS / "a1_headline.txt").write_text(text + "\n", encoding="utf-8")
    good = all(
        one.get("holds", True) and one.get("same", {}).get("largest_difference_of_vx", 0.0) == 0.0
        for one in places
    )
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
