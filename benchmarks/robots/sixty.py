"""Sixty Go1 machines of code of their own, answered from their logs alone: are the true causes named?

Run, in this order, each with OMP_NUM_THREADS=1:

    python -m benchmarks.robots.sixty make   --folder FOLDER [--seed SEED] [--part 0/2]
    python -m benchmarks.robots.sixty answer --folder FOLDER [--part 0/2] [--cache CACHE] [--write]
    python -m benchmarks.robots.sixty score  --folder FOLDER [--write]

``make`` draws the machines (:mod:`.go1`): their logs in ``logs``, their causes in ``labels``. ``answer`` reads the logs
alone; with ``--write``, it freezes all answers in the repository. ``score`` opens the labels. There is one file for
each machine and step, so a second call resumes, and two processes can share a step.

| machines | causes |
| --- | --- |
| 24 | each mistake of :mod:`.machines` |
| 18 | one effect: each of :data:`CAUSES`, six of them twice; between a half and one and a half of typical |
| 8 | a mistake and an effect |
| 4 | one of :mod:`.unmodelled` |
| 6 | none |

Every machine has small amounts of all effects besides. It makes ten runs of 5 s: five commands, the same for all
machines, twice each, with other noise and another start. The diagnosis reads them as a robot logs, without the
observations, actions and targets. The check of the loop also reads these. The robot file has ten lines, and no
catalogue of its own.

:mod:`.sixty_score` says what is right.
"""

from __future__ import annotations

import argparse
import json
import re
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.blind.scoring import Axes, acting_axes
from benchmarks.robots.go1 import KINDS, Machine, Mistake, Physics, Unmodelled
from benchmarks.robots.isolability import LEVEL, chance
from benchmarks.robots.machines import LOGS, MISTAKES, checked, replayed, without
from benchmarks.robots.public import GO1
from benchmarks.robots.sixty_score import frozen, score
from benchmarks.robots.unmodelled import UNMODELLED
from s2r_spec import read_trace, write_trace
from s2r_spec.backend import Backend, HasLoop, load_backend
from s2r_spec.base.errors import S2RError
from s2r_spec.diagnose import Diagnosis, diagnose
from s2r_spec.diagnose.inference.prior import POSSIBLE
from s2r_spec.diagnose.simulator.axes import EffectAxis
from s2r_spec.spec import load_spec
from s2r_spec.trace import Trace

ANSWERS = Path(__file__).parents[1] / "results" / "go1_sixty_answers.json"
SPEC = """\
signal vx {m/s}
param  vd {m/s} in [0.2, 0.8]
const  tol = 0.15 {m/s}
require walking: always[2 s, 4 s] (abs(vx - vd) <= tol)
certify walking: fall = -1
"""
WINDOW, TOLERANCE = (2.0, 4.0), 0.15
"""Definition: the window [s] and the tolerance [m/s] of the requirement, for the generator's own judgement."""
COMMANDS, REPEATS = (0.22, 0.36, 0.5, 0.64, 0.78), 2
"""Definition: forward commands of the runs [m/s], and runs of each."""
CAUSES = (
    "dry_friction", "viscous_friction", "armature", "motor_strength", "payload", "com_offset", "slope",
    "ground_friction", "action_delay", "encoder_offset", "imu_tilt", "gyro_bias",
)  # fmt: skip
"""Definition: effects of the catalogue that the generator has a law of its own for."""
SINGLE, PAIRS, HEALTHY = 18, 8, 6
"""Definition: machines with one effect, with a mistake and an effect, and with nothing."""
SIZES = 0.5, 1.5
"""Definition: range of the size of an effect, in typical sizes."""
SEED = 650_065
"""Definition: seed of the study. No machine of it was looked at before its answers were frozen."""


@dataclass(frozen=True)
class Case:
    """A machine: its kind and its causes."""

    kind: str
    mistake: Mistake | None = None
    physics: Mapping[str, Mapping[str, float]] | None = None
    unmodelled: Unmodelled | None = None

    @property
    def causes(self) -> list[str]:
        """The names of its causes."""
        other = [one.name for one in (self.mistake, self.unmodelled) if one]
        return [*other, *(self.physics or {})]

    def machine(self, seed: Sequence[int], noise: Sequence[int]) -> Machine:
        """Return the machine of a seed of its small amounts, and one of its noise."""
        return Machine(seed, self.physics, self.mistake, unmodelled=self.unmodelled, noise=noise)

    def lacking(self, cause: str) -> Case:
        """Return the machine without one of its causes."""
        same = {name: one for name, one in (self.physics or {}).items() if name != cause}
        mistake = None if self.mistake and self.mistake.name == cause else self.mistake
        other = None if self.unmodelled and self.unmodelled.name == cause else self.unmodelled
        return replace(self, mistake=mistake, physics=same, unmodelled=other)


def drawn(seed: int, axes: Axes) -> list[Case]:
    """Return all machines of a seed, in random order."""
    rng = np.random.default_rng([seed])

    def effects(names: Sequence[str]) -> list[Physics]:
        return [physics_of(name, axes, rng) for name in names]

    def some(names: Sequence[Any], count: int) -> list[Any]:
        return [names[k] for k in rng.permutation(len(names))[:count]]

    cases = [Case("interface", one) for one in MISTAKES]
    cases += [Case("physics", None, one) for one in effects([*CAUSES, *some(CAUSES, SINGLE - len(CAUSES))])]
    # A mistake that begins later stops every diagnosis of effects.
    pairs = zip(some(MISTAKES[:-1], PAIRS), effects(some(CAUSES, PAIRS)), strict=True)
    cases += [Case("pair", mistake, effect) for mistake, effect in pairs]
    cases += [Case("unknown", unmodelled=one) for one in UNMODELLED]
    cases += HEALTHY * [Case("nothing")]
    return [cases[k] for k in rng.permutation(len(cases))]


def physics_of(effect: str, axes: Axes, rng: np.random.Generator) -> Physics:
    """Return effect → parameter → value: of all kinds of joints, or of one parameter of the effect."""
    size, own = float(np.exp(rng.uniform(*np.log(SIZES)))), axes[effect]
    if {axis.parameter for axis in own} == {*KINDS}:
        return {effect: {axis.parameter: _value(axis, size, rng) for axis in own}}
    axis = own[int(rng.integers(len(own)))]
    return {effect: {axis.parameter: _value(axis, size, rng)}}


def _value(axis: EffectAxis, size: float, rng: np.random.Generator) -> float:
    low, high = axis.ends
    side = -1.0 if high <= 0.0 or (low < 0.0 and axis.effect != "payload" and rng.uniform() < 0.5) else 1.0
    if axis.effect in ("motor_strength", "ground_friction"):
        side = -1.0
    return float(f"{axis.value(side * size):.4g}")


def runs_of(machine: Machine) -> list[list[Trace]]:
    """Return (commands, repeats) logs with everything."""
    return [[machine.drive(vd) for _ in range(REPEATS)] for vd in COMMANDS]


def holds(runs: Sequence[Sequence[Trace]]) -> float:
    """Return the share of the runs that meet the requirement."""
    every, (since, until) = [log for row in runs for log in row], WINDOW
    met = []
    for log in every:
        within = (log.times > since - 1e-9) & (log.times < until + 1e-9)
        error = np.abs(np.asarray(log["vx"]) - np.asarray(log["vx_cmd"]))[within]
        met.append(log.failure is None and float(error.max()) <= TOLERANCE)
    return float(np.mean(met))


def label_of(case: Case, own: Sequence[int]) -> dict[str, Any]:
    """Return the label of a machine, with what its generator finds by running it without each of its causes."""
    machine = case.machine([*own, 1], [*own, 3])
    present = runs_of(machine) if case.causes else []
    visible, breaking = {}, {}
    for number, cause in enumerate(case.causes):
        absent = runs_of(case.lacking(cause).machine([*own, 1], [*own, 4, number]))
        logs = [[[without(log, LOGS["tau"]) for log in row] for row in rows] for rows in (present, absent)]
        visible[cause] = chance(*logs)
        breaking[cause] = holds(present) < 0.5 <= holds(absent)
    return {
        "kind": case.kind,
        "mistake": case.mistake.name if case.mistake else None,
        "effects": case.physics or {},
        "unmodelled": case.unmodelled.name if case.unmodelled else None,
        "chance": visible,
        "visible": [cause for cause, p in visible.items() if p < LEVEL],
        "breaks the requirement": [cause for cause, breaks in breaking.items() if breaks],
        "background": machine.values,
    }


def make(folder: Path, seed: int, robot: Backend, numbers: Sequence[int]) -> None:
    """Write the logs and the label of each machine."""
    mark = folder / "seed.json"
    if not mark.exists():
        mark.write_text(json.dumps(seed))
    if json.loads(mark.read_text()) != seed:
        raise SystemExit(f"{folder} has machines of another seed")
    cases = drawn(seed, acting_axes(robot, load_spec(folder / "walk.stl").space))
    (folder / "labels").mkdir(exist_ok=True)
    for number in numbers:
        path, own = folder / "labels" / f"{number:02d}.json", [seed, number]
        if path.exists():
            continue
        logs = folder / "logs" / f"{number:02d}"
        logs.mkdir(parents=True, exist_ok=True)
        runs = runs_of(cases[number].machine([*own, 1], [*own, 2]))
        for count, log in enumerate(log for row in runs for log in row):
            write_trace(log, logs / f"{count}.npz")
        path.write_text(json.dumps({"seed": seed, **label_of(cases[number], own)}, default=float, indent=1))
        print(f"{number:02d}", flush=True)


def recorded(folder: Path, number: int) -> list[Trace]:
    """Return the logs of a machine, with everything."""
    return [read_trace(path) for path in sorted((folder / "logs" / f"{number:02d}").glob("*.npz"))]


def answer(folder: Path, robot: Backend, numbers: Sequence[int], cache: Path) -> None:
    """Write the answer of each machine, from its logs alone."""
    from benchmarks.a1.gaps import step_of_the_a1

    assert isinstance(robot, HasLoop)
    (folder / "answers").mkdir(exist_ok=True)
    for number in numbers:
        path = folder / "answers" / f"{number:02d}.json"
        if path.exists():
            continue
        logs = recorded(folder, number)
        if not logs:
            raise SystemExit(f"{folder} has no logs of machine {number}: make it first")
        runs = [({"vd": float(log["vx_cmd"][0])}, without(log, LOGS["tau"])) for log in logs]
        began = time.process_time()
        found = answered(folder / "walk.stl", robot, runs, cache)
        found |= {"seconds": time.process_time() - began, "step of the A1": step_of_the_a1()}
        began = time.process_time()
        found |= {"checked": checked(robot, logs), "replayed": replayed(robot, logs)}
        found["seconds of the loop"] = time.process_time() - began
        path.write_text(json.dumps(found, default=float))
        print(f"{number:02d}", found["verdict"], found["named"], f"{found['seconds']:.0f} s", flush=True)


def answered(
    spec: Path, robot: Backend, runs: Sequence[tuple[dict[str, float], Trace]], cache: Path
) -> dict[str, Any]:
    """Return the answer to the logs of a machine; an error is an answer, too."""
    try:
        found = diagnose(spec, robot, runs, cache=cache, where=False, passive=True)
    except S2RError as error:
        nothing: dict[str, Any] = {"effects": [], "mistakes": []}
        which = {"answer": [], "set": [], "status": {}, "posterior": {}, "pairs": [], "parameters": {}}
        return {
            "verdict": "error", "rule": "error", "reason": str(error), "exit_code": 2, "which": which,
            "named": nothing, "possible": nothing, "loop": None, "findings": [],
        }  # fmt: skip
    likely = [] if found.evidence.loop is None else _loops(found)
    return {
        **found.to_json(),
        "named": {"effects": list(found.which.answer), "mistakes": _mistakes(found)},
        "possible": {"effects": [one.effect for one in found.which.possible], "mistakes": likely},
    }


def _mistakes(found: Diagnosis) -> list[str]:
    """Return the named mistakes of the loop; one that no file can state is in a finding."""
    if found.mistakes:
        return [one.name for one in found.mistakes]
    texts = [one.text for one in found.evidence.findings if one.code == "loop"]
    return [words for text in texts for words in re.findall(r"has a mistake: (.*)\. Correct it", text)]


def _loops(found: Diagnosis) -> list[str]:
    """Return the loops with a mistake that are possible, in words."""
    loop = found.evidence.loop
    assert loop is not None
    first = " and ".join(one.name for one in loop.mistakes)
    every = [(first, loop.probability), *loop.rivals]
    return [words for words, p in every if words and p >= POSSIBLE]


def freeze(folder: Path) -> None:
    """Write what is frozen of all answers into the repository."""
    paths = sorted((folder / "answers").glob("*.json"))
    if len(paths) < (whole := len(MISTAKES) + SINGLE + PAIRS + len(UNMODELLED) + HEALTHY):
        raise SystemExit(f"{len(paths)} of {whole} machines are answered")
    every = {path.stem: frozen(json.loads(path.read_text())) for path in paths}
    rows = (f" {json.dumps(name)}: {json.dumps(one, ensure_ascii=False)}" for name, one in every.items())
    ANSWERS.write_text("{\n" + ",\n".join(rows) + "\n}\n")


def main() -> None:
    """Make, answer or score the machines."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("step", choices=("make", "answer", "score"))
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--seed", type=int, default=SEED, help="of the machines, for make")
    parser.add_argument("--part", default="0/1", help="K/N: every Nth machine, from K on")
    parser.add_argument("--only", type=int, nargs="+", help="numbers of machines")
    parser.add_argument("--cache", type=Path, help="folder of what is simulated once; else in the folder")
    parser.add_argument(
        "--write", action="store_true", help="keep the answers or the scores in the repository"
    )
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    for name, text in (("go1.toml", GO1), ("walk.stl", SPEC)):
        if not (given.folder / name).exists():
            (given.folder / name).write_text(text)
    robot = load_backend(str(given.folder / "go1.toml"))
    first, of = map(int, given.part.split("/"))
    numbers = given.only or range(first, len(MISTAKES) + SINGLE + PAIRS + len(UNMODELLED) + HEALTHY, of)
    if given.step == "make":
        make(given.folder, given.seed, robot, numbers)
    elif given.step == "answer":
        answer(given.folder, robot, numbers, given.cache or given.folder / "cache")
        if given.write:
            freeze(given.folder)
    else:
        score(given.folder, robot, given.write)


if __name__ == "__main__":
    main()
