"""Go1 machines of a generator with code of its own, with one mistake in the code around the policy.

Run: OMP_NUM_THREADS=1 python -m benchmarks.robots.machines [--rollouts 3] [--write]

Every machine is a **twin** (:mod:`.go1`) with small amounts of all effects. A log has what a robot logs: the measured
state, `obs`, `action`, `target` and `tau`.

For each mistake the command prints what ``s2r backends robot.toml --log`` says of these logs, and counts the mistakes
that it names with their term and kind. Healthy machines must have none.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.robots.go1 import TICK, Array, Edit, Machine, Mistake
from benchmarks.robots.public import GO1
from s2r_spec.backend import HasLoop, load_backend

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


def main() -> None:
    """Print and count what the check says of every mistake, and of healthy machines."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rollouts", type=int, default=3)
    parser.add_argument("--healthy", type=int, default=6)
    parser.add_argument("--write", action="store_true", help=f"keep the counts in {RESULT.name}")
    given = parser.parse_args()
    with TemporaryDirectory() as folder:
        (Path(folder) / "go1.toml").write_text(GO1)
        robot = load_backend(str(Path(folder) / "go1.toml"))
        assert isinstance(robot, HasLoop)
        named, certain, rows = 0, 0, {}
        for seed, mistake in enumerate((*MISTAKES, *(given.healthy * [None]))):
            machine, found = Machine(seed, mistake=mistake), {}
            for vd in np.linspace(0.3, 0.7, given.rollouts).tolist():
                for one in robot.loop(machine.drive(vd)):
                    if one.level == "wrong" and one.topic != "torque":
                        found[one.words] = one.certain
            name = mistake.name if mistake else f"healthy {seed - len(MISTAKES) + 1}"
            rows[name] = sorted(found)
            if mistake:
                right = any(w.startswith(mistake.quantity) and mistake.kind in w for w in found)
                named, certain = named + right, certain + any(found.values())
                print("right" if right else "WRONG", "|", name, "|", "; ".join(sorted(found)), flush=True)
            else:
                print("right" if not found else "WRONG", "|", name, "|", "; ".join(sorted(found)), flush=True)
    healthy = [name for name in rows if name.startswith("healthy") and not rows[name]]
    counts = {
        "mistakes named with term and kind": f"{named} of {len(MISTAKES)}",
        "healthy machines without a finding": f"{len(healthy)} of {given.healthy}",
    }
    print(json.dumps(counts, indent=1))
    if given.write:
        RESULT.write_text(json.dumps({**counts, "found": rows}, indent=1, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    main()
