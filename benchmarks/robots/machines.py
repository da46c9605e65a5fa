"""Go1 machines of a generator with code of its own, with one mistake in the code around the policy.

Run: OMP_NUM_THREADS=1 python -m benchmarks.robots.machines [--rollouts 3] [--write]

Every machine is a **twin**: MuJoCo with a step of 1 ms instead of 4, joints that rub by a Stribeck law, noise of every
sensor, and a few percent of dry friction, payload, strength and offset. Its loop is written out here, and shares
nothing with `backends/s2r_mujoco`. A log has what a robot logs: the measured state, `obs`, `action`, `target`, `tau`.

For each mistake the command prints what ``s2r backends robot.toml --log`` says of these logs, and counts the mistakes
that it names with their term and kind. Healthy machines must have none.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import mujoco
import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from benchmarks.robots.public import GO1, ROBOTS
from s2r_spec.backend import HasLoop, load_backend
from s2r_spec.trace import Trace

RESULT = Path(__file__).parents[1] / "results" / "go1_loops.json"
SCENE = ROBOTS / "go1_playground" / "scene_mjx_feetonly_flat_terrain.xml"
POLICY = ROBOTS / "go1_playground" / "go1_policy.onnx"
STEP, TICK, SECONDS, SCALE = 0.001, 0.02, 5.0, 0.5
"""Definition: physics step, control period and duration [s]; scale of the action."""
NOISE = {"q": 0.002, "dq": 0.05, "gyro": 0.02, "linvel": 0.02, "quaternion": 0.002}
"""Definition: standard deviation of each sensor's noise, in its unit."""
FELL = 0.15
"""Definition: height below which a robot has fallen [m]."""

Array = NDArray[np.float64]
Edit = Callable[[dict[str, Array], int, list[dict[str, Array]]], None]
"""Changes the parts of an observation, from the number of the tick and the parts of all ticks so far."""


@dataclass(frozen=True)
class Mistake:
    """A mistake, the quantity that it is in, and words of the sentence that names its kind."""

    name: str
    quantity: str
    kind: str
    observed: Edit | None = None
    target: Callable[[Array, Array], Array] | None = None


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


class Machine:
    """One Go1 with its own small faults, and a loop written out."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        spec = mujoco.MjSpec.from_file(str(SCENE))
        spec.option.timestep = STEP
        self.model = spec.compile()
        self.model.body_mass[1] += 0.3 * abs(rng.normal())
        self.model.actuator_gainprm[:, 0] *= 1.0 + 0.01 * rng.normal()
        self.rub, self.rise = 0.05 * abs(rng.normal()), 0.5
        self.offset = 0.003 * rng.normal(size=12)
        self.session = ort.InferenceSession(str(POLICY))
        self.home = self.model.key_qpos[0][7:].copy()
        self.rng = rng

    def measured(self, data: mujoco.MjData) -> dict[str, Array]:
        """Return what the sensors say now."""
        r, noise = self.rng, NOISE
        linvel, gyro, turn = data.sensor("local_linvel").data, data.sensor("gyro").data, np.zeros(9)
        quaternion = data.qpos[3:7] + noise["quaternion"] * r.normal(size=4)
        mujoco.mju_quat2Mat(turn, quaternion / np.linalg.norm(quaternion))
        return {
            "q": data.qpos[7:] + self.offset + noise["q"] * r.normal(size=12),
            "dq": data.qvel[6:] + noise["dq"] * r.normal(size=12),
            "gyro": gyro + noise["gyro"] * r.normal(size=3),
            "linvel": linvel + noise["linvel"] * r.normal(size=3),
            "quaternion": quaternion / np.linalg.norm(quaternion),
            "attitude": turn,
        }

    def drive(self, vd: float, mistake: Mistake | None) -> Trace:
        """Return the log of one run at a forward command [m/s]; it ends at a fall."""
        data = mujoco.MjData(self.model)
        mujoco.mj_resetDataKeyframe(self.model, data, 0)
        data.qvel[6:] += 0.05 * self.rng.normal(size=12)
        mujoco.mj_forward(self.model, data)
        last, command, rows, past = np.zeros(12), np.array([vd, 0.0, 0.0]), [], []
        for tick in range(round(SECONDS / TICK) + 1):
            state = self.measured(data)
            past.append(
                {
                    "local_linvel": state["linvel"], "gyro": state["gyro"],
                    "projected_gravity": -state["attitude"].reshape(3, 3)[2],
                    "joint_pos_rel": state["q"] - self.home, "joint_vel": state["dq"], "last_action": last,
                    "velocity_commands": command, "attitude": state["attitude"],
                }
            )  # fmt: skip
            parts = {name: value for name, value in past[-1].items() if name != "attitude"}
            if mistake is not None and mistake.observed is not None:
                mistake.observed(parts, tick, past)
            observation = np.concatenate([*parts.values()]).astype(np.float32)
            action = self.session.run(None, {"obs": observation[None]})[0][0].astype(np.float64)
            target = self.home + SCALE * action
            if mistake is not None and mistake.target is not None:
                target = mistake.target(target, self.home)
            data.ctrl[:] = target
            torque = data.actuator_force.copy()
            rows.append({**state, "obs": observation, "action": action, "target": target, "tau": torque})
            last = action
            for _ in range(round(TICK / STEP)):
                v = data.qvel[6:]
                data.qfrc_applied[6:] = (
                    -self.rub * (1.0 + self.rise * np.exp(-((v / 0.1) ** 2))) * np.tanh(v / 0.02)
                )
                mujoco.mj_step(self.model, data)
            if data.qpos[2] < FELL:
                break
        each = {name: np.array([row[name] for row in rows]) for name in rows[0] if name != "attitude"}
        channels = {"local_linvel": each.pop("linvel"), **each}
        channels |= {
            "vx_cmd": np.full(len(rows), vd),
            "vy_cmd": np.zeros(len(rows)),
            "wz_cmd": np.zeros(len(rows)),
        }
        units = {"q": "rad", "dq": "rad/s", "tau": "N*m", "gyro": "rad/s", "local_linvel": "m/s"}
        return Trace(TICK * np.arange(len(rows)), channels, units, {"source": "twin"})


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
            machine, found = Machine(seed), {}
            for vd in np.linspace(0.3, 0.7, given.rollouts).tolist():
                for one in robot.loop(machine.drive(vd, mistake)):
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
