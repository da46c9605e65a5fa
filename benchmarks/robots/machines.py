"""Go1 machines of a generator with code of its own, with one mistake in the code around the policy.

Run: OMP_NUM_THREADS=1 python -m benchmarks.robots.machines [--rollouts 3] [--seed 0] [--write]

Every machine is a **twin** (:mod:`.go1`) with small amounts of all effects. A log has what a robot logs: the measured
state and `tau`; then also `target`; then also `obs` and `action`.

For each mistake the command prints what ``s2r backends robot.toml --log`` says of logs with `obs`, and what the policy
on the state of each log says. ``s2r diagnose`` does both. It counts the mistakes that are named with term and kind.
Healthy machines must have none.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.robots.go1 import TICK, Array, Edit, Machine, Mistake
from benchmarks.robots.public import GO1
from s2r_spec.backend import HasLoop, load_backend
from s2r_spec.diagnose.inference.prior import SURE
from s2r_spec.trace import Trace

RESULT = Path(__file__).parents[1] / "results" / "go1_loops.json"


def term(name: str, change: Callable[[Array], Array]) -> Edit:
    """Return the change of one term."""

    def edit(parts: dict[str, Array], tick: int, past: list[dict[str, Array]]) -> None:
        parts[name] = change(parts[name])

    return edit


def late(name: str, ticks: int) -> Edit:
    """Return the delay of one term."""

    def edit(parts: dict[str, Array], tick: int, past: list[dict[str, Array]]) -> None:
        parts[name] = past[max(tick - ticks, 0)][name]

    return edit


def exchanged(one: str, other: str) -> Edit:
    """Return the exchange of two terms."""

    def edit(parts: dict[str, Array], tick: int, past: list[dict[str, Array]]) -> None:
        parts[one], parts[other] = parts[other], parts[one]

    return edit


def since(seconds: float, edit: Edit) -> Edit:
    """Return a change that begins later."""

    def changed(parts: dict[str, Array], tick: int, past: list[dict[str, Array]]) -> None:
        if tick * TICK >= seconds:
            edit(parts, tick, past)

    return changed


def world(name: str) -> Edit:
    """Return a vector in axes of the world."""

    def edit(parts: dict[str, Array], tick: int, past: list[dict[str, Array]]) -> None:
        parts[name] = past[tick]["attitude"].reshape(3, 3) @ parts[name]

    return edit


SIDES = np.array([3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8])
"""Definition: left and right legs exchanged."""
KINDS = np.arange(12).reshape(4, 3).T.ravel()
"""Definition: all hips, then all thighs, then all calves."""
HIPS = np.where(np.arange(12) % 3 == 0, -1.0, 1.0)
HOME = np.array(4 * [0.1, 0.9, -1.8]) * np.where(np.arange(12) % 6 == 3, -1.0, 1.0)
"""Definition: joints of the keyframe [rad]."""

MISTAKES = (
    Mistake("legs exchanged in q", "joint_pos_rel", "order", term("joint_pos_rel", lambda x: x[SIDES])),
    Mistake("legs exchanged in dq", "joint_vel", "order", term("joint_vel", lambda x: x[SIDES])),
    Mistake("q by kinds", "joint_pos_rel", "order", term("joint_pos_rel", lambda x: x[KINDS])),
    Mistake("dq by kinds", "joint_vel", "order", term("joint_vel", lambda x: x[KINDS])),
    Mistake("targets by kinds", "target", "order", target=lambda x, home: x[KINDS]),
    Mistake("legs exchanged in targets", "target", "order", target=lambda x, home: x[SIDES]),
    Mistake("sign of hips in q", "joint_pos_rel", "wrong sign", term("joint_pos_rel", lambda x: HIPS * x)),
    Mistake("sign of hips in dq", "joint_vel", "wrong sign", term("joint_vel", lambda x: HIPS * x)),
    Mistake("sign of gravity", "projected_gravity", "sign", term("projected_gravity", lambda x: -x)),
    Mistake("sign of the yaw rate", "gyro", "wrong sign", term("gyro", lambda x: x * [1, 1, -1])),
    Mistake("gyro in degrees", "gyro", "degrees", term("gyro", np.degrees)),
    Mistake("gyro a quarter", "gyro", "0.25 times", term("gyro", lambda x: 0.25 * x)),
    Mistake("dq a twentieth", "joint_vel", "0.05 times", term("joint_vel", lambda x: 0.05 * x)),
    Mistake("velocity doubled", "local_linvel", "2 times", term("local_linvel", lambda x: 2.0 * x)),
    Mistake("velocity of the world", "local_linvel", "world", world("local_linvel")),
    Mistake("velocity missing", "local_linvel", "zero", term("local_linvel", lambda x: 0.0 * x)),
    Mistake("last action missing", "last_action", "zero", term("last_action", lambda x: 0.0 * x)),
    Mistake("last action of two ticks ago", "last_action", "late", late("last_action", 1)),
    Mistake("command doubled", "velocity_commands", "2 times", term("velocity_commands", lambda x: 2.0 * x)),
    Mistake("default pose left out", "joint_pos_rel", "default pose", term("joint_pos_rel", lambda x: x + HOME)),
    Mistake("q two ticks late", "joint_pos_rel", "late", late("joint_pos_rel", 2)),
    Mistake("gyro and velocity exchanged", "gyro", "holds local_linvel", exchanged("gyro", "local_linvel")),
    Mistake("action scale halved", "target", "0.5 times", target=lambda x, home: home + 0.5 * (x - home)),
    Mistake("sign of gyro from 1 s on", "gyro", "sign", since(1.0, term("gyro", lambda x: -x))),
)  # fmt: skip


NAMES = {
    "legs exchanged in q": "joint_pos_rel has left and right exchanged",
    "legs exchanged in dq": "joint_vel has left and right exchanged",
    "q by kinds": "joint_pos_rel is ordered by kind of joint",
    "dq by kinds": "joint_vel is ordered by kind of joint",
    "targets by kinds": "target is ordered by kind of joint",
    "legs exchanged in targets": "target has left and right exchanged",
    "sign of hips in q": "joint_pos_rel has the wrong sign in hip",
    "sign of hips in dq": "joint_vel has the wrong sign in hip",
    "sign of gravity": "projected_gravity has the wrong sign",
    "sign of the yaw rate": "gyro has the wrong sign in z",
    "gyro in degrees": "gyro is 57.3 times as large: in degrees instead of radians",
    "gyro a quarter": "gyro is 0.25 times as large",
    "dq a twentieth": "joint_vel is 0.05 times as large",
    "velocity doubled": "local_linvel is 2 times as large",
    "velocity of the world": "local_linvel is in axes of the world",
    "velocity missing": "local_linvel is always zero",
    "last action missing": "last_action is always zero",
    "last action of two ticks ago": "last_action is 1 tick late",
    "command doubled": "velocity_commands is 2 times as large",
    "default pose left out": "joint_pos_rel has no default pose subtracted",
    "q two ticks late": "joint_pos_rel is 2 ticks late",
    "gyro and velocity exchanged": "local_linvel and gyro are exchanged",
    "action scale halved": "target has 0.5 times the scale of the action",
    "sign of gyro from 1 s on": "gyro has the wrong sign from t",
}  # fmt: skip
"""Definition: mistake → what a replay of its logs must say, or begin with."""
LOGS = {"check": (), "all": (), "target": ("obs", "action"), "tau": ("obs", "action", "target")}
"""Definition: what a log is judged by → the channels that it lacks."""


def without(trace: Trace, channels: tuple[str, ...]) -> Trace:
    """Return a log without some channels."""
    kept = {name: np.asarray(trace[name]) for name in trace.channels if name not in channels}
    return Trace(trace.times, kept, {k: u for k, u in trace.units.items() if k in kept}, trace.meta)


def checked(robot: HasLoop, logs: Sequence[Trace]) -> list[str]:
    """Return what the check of the whole loop calls wrong in logs with everything."""
    found = (one for log in logs for one in robot.loop(log))
    return sorted({one.words for one in found if one.level == "wrong" and one.topic != "torque"})


def replayed(robot: HasLoop, logs: Sequence[Trace]) -> list[str]:
    """Return the mistakes that the policy on the state of the logs surely shows."""
    found = robot.replayed(logs)
    assert found is not None
    return [one.name for one in found.mistakes] if found.explained and found.probability >= SURE else []


def is_checked(words: Sequence[str], mistake: Mistake | None) -> bool:
    """Return whether the check of the whole loop is right: of a healthy machine, it says nothing."""
    if mistake is None:
        return not words
    return any(one.startswith(mistake.quantity) and mistake.kind in one for one in words)


def is_named(names: Sequence[str], mistake: Mistake | None) -> bool:
    """Return whether just the mistake is named; of a healthy machine, none."""
    if mistake is None:
        return not names
    return len(names) == 1 and names[0].startswith(NAMES[mistake.name])


def main() -> None:
    """Print and count what both say of every mistake, and of healthy machines."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rollouts", type=int, default=3)
    parser.add_argument("--healthy", type=int, default=6)
    parser.add_argument("--seed", type=int, default=0, help="of the first machine")
    parser.add_argument("--write", action="store_true", help=f"keep the counts in {RESULT.name}")
    given = parser.parse_args()
    every: list[Mistake | None] = [*MISTAKES, *(given.healthy * [None])]
    rows: dict[str, dict[str, list[str]]] = {}
    right = {log: [0, 0] for log in LOGS}
    with TemporaryDirectory() as folder:
        (Path(folder) / "go1.toml").write_text(GO1)
        robot = load_backend(str(Path(folder) / "go1.toml"))
        assert isinstance(robot, HasLoop)
        for number, mistake in enumerate(every):
            machine = Machine(given.seed + number, mistake=mistake)
            runs = [machine.drive(vd) for vd in np.linspace(0.3, 0.7, given.rollouts).tolist()]
            name = mistake.name if mistake else f"healthy {number - len(MISTAKES) + 1}"
            rows[name] = {}
            for log, lacking in LOGS.items():
                says, judged = (checked, is_checked) if log == "check" else (replayed, is_named)
                rows[name][log] = says(robot, [without(run, lacking) for run in runs])
                good = judged(rows[name][log], mistake)
                right[log][mistake is None] += good
                print(
                    "right" if good else "WRONG",
                    "|",
                    name,
                    "|",
                    log,
                    "|",
                    "; ".join(rows[name][log]),
                    flush=True,
                )
    counts = {
        log: {
            "mistakes named": f"{good[0]} of {len(MISTAKES)}",
            "healthy machines cleared": f"{good[1]} of {given.healthy}",
        }
        for log, good in right.items()
    }
    print(json.dumps(counts, indent=1))
    if given.write:
        result = {"seed": given.seed, "rollouts": given.rollouts, **counts, "found": rows}
        RESULT.write_text(json.dumps(result, indent=1, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    main()
