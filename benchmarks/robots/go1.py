"""A Go1 of code of its own: MuJoCo with another step and other laws, and a loop that is written out.

It is a **twin**. It shares the model's file and the policy with `backends/s2r_mujoco`, and no code.

| | simulator | here |
| --- | --- | --- |
| physics step | 4 ms | 1 ms |
| dry friction | MuJoCo's constraint | Stribeck law by tanh, twice as much at rest |
| viscous friction | linear | grease that thins with speed |
| payload | added to the root's mass | a box on the back |
| delays | blend of two ticks | a queue of messages with 10 % of jitter |
| sensors | exact | noise of each, and encoders with offsets |
| `tau` | within the physics step after the sample | the same; a robot may report the torque before the tick's target |
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from benchmarks.robots.public import ROBOTS
from s2r_spec.trace import Trace

SCENE = ROBOTS / "go1_playground" / "scene_mjx_feetonly_flat_terrain.xml"
POLICY = ROBOTS / "go1_playground" / "go1_policy.onnx"
STEP, TICK, SECONDS, SCALE = 0.001, 0.02, 5.0, 0.5
"""Definition: physics step, control period and duration [s]; scale of the action."""
NOISE = {"q": 0.002, "dq": 0.05, "gyro": 0.02, "linvel": 0.02, "quaternion": 0.002, "vx": 0.01}
"""Definition: standard deviation of each sensor's noise, in its unit."""
FELL = 0.15
"""Definition: height below which a robot has fallen [m]."""
RISE, STRIBECK, SMOOTH, THIN = 1.0, 0.1, 0.02, 8.0
"""Definition: rise of dry friction at rest, in parts; its speed, that of tanh, and of grease that thins [rad/s]."""
JITTER = 0.1
"""Definition: standard deviation of a delay, in parts of it."""
KINDS = ("hip", "thigh", "calf")
SIGNED = ("encoder_offset", "imu_tilt", "gyro_bias", "com_offset", "slope")
"""Definition: effects of two signs; the others are sizes or factors."""

Array = NDArray[np.float64]
Physics = Mapping[str, Mapping[str, float]]
"""Effect → parameter → value, as in the catalogue of a robot file."""
Edit = Callable[[dict[str, Array], int, list[dict[str, Array]]], None]
"""Changes the parts of an observation, from the number of the tick and the parts of all ticks so far."""


@dataclass(frozen=True)
class Mistake:
    """A mistake of the loop, the quantity that it is in, and words of the sentence that names its kind."""

    name: str
    quantity: str
    kind: str
    observed: Edit | None = None
    target: Callable[[Array, Array], Array] | None = None


@dataclass(frozen=True)
class Unmodelled:
    """A cause that no catalogue has.

    Attributes:
        name: in words.
        build: changes the compiled model.
        force: adds forces to the data before each physics step; it may draw numbers.
    """

    name: str
    build: Callable[[mujoco.MjModel], None] | None = None
    force: Callable[[mujoco.MjData, np.random.Generator], None] | None = None


class Machine:
    """One Go1 with small amounts of all effects, some that are larger, and perhaps a mistake of its loop.

    Args:
        seed: of the small amounts, and of noise and start of the runs.
        physics: the effects that are larger.
        mistake: of its loop.
        unmodelled: a cause outside every catalogue.
        noise: seed of noise and start of the runs alone.

    Attributes:
        values: effect → parameter → value of this machine, small amounts included.
    """

    def __init__(
        self,
        seed: int | Sequence[int],
        physics: Physics | None = None,
        mistake: Mistake | None = None,
        *,
        unmodelled: Unmodelled | None = None,
        noise: Sequence[int] | None = None,
    ) -> None:
        self.rng, self.mistake, self.physics = np.random.default_rng(seed), mistake, physics or {}
        self.unmodelled = unmodelled or Unmodelled("nothing")
        self.values: dict[str, dict[str, float]] = {}
        self.rub = self._joints("dry_friction", 0.03)
        self.grease = self._joints("viscous_friction", 0.005)
        self.offset = self._joints("encoder_offset", 0.002)
        self.tilt = np.radians([self._one("imu_tilt", axis, 0.1) for axis in ("roll", "pitch")])
        self.bias = np.array([self._one("gyro_bias", axis, 0.003) for axis in "xyz"])
        self.sending = self._one("action_delay", "time", 0.0005)
        self.sensing = self._one("observation_delay", "time", 0.0005)
        self.model = self._made()
        self.session = ort.InferenceSession(str(POLICY))
        self.home = self.model.key_qpos[0][7:].copy()
        if noise is not None:
            self.rng = np.random.default_rng(noise)

    def _one(self, effect: str, parameter: str, small: float, nominal: float = 0.0) -> float:
        """Return a number of the machine: the given one, or one near nominal."""
        other = nominal + small * float(self.rng.normal())
        value = self.physics.get(effect, {}).get(parameter, other)
        value = value if effect in SIGNED else abs(value)
        self.values.setdefault(effect, {})[parameter] = value
        return value

    def _joints(self, effect: str, small: float, nominal: float = 0.0) -> Array:
        return np.array(4 * [self._one(effect, kind, small, nominal) for kind in KINDS])

    def _made(self) -> mujoco.MjModel:
        spec = mujoco.MjSpec.from_file(str(SCENE))
        spec.option.timestep = STEP
        load = self._one("payload", "mass", 0.1)
        spec.body("trunk").add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.08, 0.05, 0.02], pos=[0.0, 0.0, 0.08], mass=load,
            contype=0, conaffinity=0,
        )  # fmt: skip
        # The trunk has an inertia of its own in the file, so MuJoCo leaves the box out of it; it is added here.
        model = spec.compile()
        trunk = model.body("trunk").id
        model.body_mass[trunk] += load
        model.body_ipos[trunk] += load / model.body_mass[trunk] * np.array([0.0, 0.0, 0.08])
        model.body_ipos[trunk] += [self._one("com_offset", axis, 0.001) for axis in "xyz"]
        strength = self._joints("motor_strength", 0.005, 1.0)
        model.actuator_gainprm[:, 0] *= strength
        model.actuator_biasprm[:, 1:3] *= strength[:, None]
        model.dof_armature[6:] += self._joints("armature", 0.0003)
        model.geom_friction[:, 0] *= self._one("ground_friction", "factor", 0.02, 1.0)
        lean = np.radians([self._one("slope", way, 0.1) for way in ("forward", "left")])
        model.opt.gravity[:] = 9.81 * np.array(
            [np.sin(lean[0]), np.sin(lean[1]), -np.sqrt(1.0 - np.sum(np.sin(lean) ** 2))]
        )
        turn = np.cross([0.0, 0.0, -1.0], model.opt.gravity / 9.81)
        self.level = np.array([np.sqrt(1.0 - 0.25 * turn @ turn), *(-0.5 * turn)])
        if self.unmodelled.build is not None:
            self.unmodelled.build(model)
        mujoco.mj_setConst(model, mujoco.MjData(model))
        return model

    def measured(self, data: mujoco.MjData) -> dict[str, Array]:
        """Return what the sensors say now."""
        draw, turn, imu, quaternion = self.rng.normal, np.zeros(9), np.zeros(4), np.zeros(4)
        mujoco.mju_euler2Quat(imu, np.array([*self.tilt, 0.0]), "xyz")
        mujoco.mju_quat2Mat(turn, imu)
        turn = turn.reshape(3, 3)
        # An IMU finds the vertical by gravity, so on a slope its world leans, too.
        mujoco.mju_mulQuat(quaternion, self.level, data.qpos[3:7])
        mujoco.mju_mulQuat(quaternion, quaternion.copy(), imu)
        quaternion += NOISE["quaternion"] * draw(size=4)
        return {
            "q": data.qpos[7:] + self.offset + NOISE["q"] * draw(size=12),
            "dq": data.qvel[6:] + NOISE["dq"] * draw(size=12),
            "gyro": data.sensor("gyro").data @ turn + self.bias + NOISE["gyro"] * draw(size=3),
            "local_linvel": data.sensor("local_linvel").data @ turn + NOISE["linvel"] * draw(size=3),
            "quaternion": quaternion / np.linalg.norm(quaternion),
        }

    def drive(self, vd: float) -> Trace:
        """Return the log of one run at a forward command [m/s]; it ends at a fall."""
        data = mujoco.MjData(self.model)
        mujoco.mj_resetDataKeyframe(self.model, data, 0)
        data.qpos[7:] += 0.02 * self.rng.normal(size=12)
        data.qvel[6:] += 0.05 * self.rng.normal(size=12)
        mujoco.mj_forward(self.model, data)
        last, command, mistake = np.zeros(12), np.array([vd, 0.0, 0.0]), self.mistake
        rows: list[dict[str, Array]] = []
        sensed: list[dict[str, Array]] = []
        past: list[dict[str, Array]] = []
        queue: list[tuple[float, Array]] = []
        arrived = self.home
        for tick in range(round(SECONDS / TICK) + 1):
            sensed.append(self.measured(data))
            state = self._received(sensed)
            turn = np.zeros(9)
            mujoco.mju_quat2Mat(turn, state["quaternion"])
            past.append(
                {
                    "local_linvel": state["local_linvel"], "gyro": state["gyro"],
                    "projected_gravity": -turn.reshape(3, 3)[2], "joint_pos_rel": state["q"] - self.home,
                    "joint_vel": state["dq"], "last_action": last, "velocity_commands": command, "attitude": turn,
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
            heading = np.arctan2(*data.xmat[1].reshape(3, 3)[[1, 0], 0])
            vx = data.qvel[0] * np.cos(heading) + data.qvel[1] * np.sin(heading)
            rows.append(
                {
                    **state, "obs": observation, "action": action, "target": target,
                    "vx": np.array(vx + NOISE["vx"] * self.rng.normal()), "height": data.qpos[2].copy(),
                }
            )  # fmt: skip
            last = action
            queue.append((data.time + self.sending * max(0.0, 1.0 + JITTER * self.rng.normal()), target))
            for _ in range(round(TICK / STEP)):
                while queue and queue[0][0] <= data.time + 1e-9:
                    arrived = queue.pop(0)[1]
                data.ctrl[:] = arrived - self.offset
                data.qfrc_applied[6:] = self._friction(data.qvel[6:])
                if self.unmodelled.force is not None:
                    self.unmodelled.force(data, self.rng)
                mujoco.mj_step(self.model, data)
                rows[-1].setdefault(
                    "tau", data.actuator_force.copy()
                )  # that of the tick's own target, as simulated
            if data.qpos[2] < FELL:
                return _trace(rows, vd, {"source": "twin", "failure": "fell"})
        return _trace(rows, vd, {"source": "twin"})

    def _received(self, sensed: list[dict[str, Array]]) -> dict[str, Array]:
        """Return what has arrived from the sensors: the computer, and its log, have nothing newer."""
        ticks = self.sensing * max(0.0, 1.0 + JITTER * self.rng.normal()) / TICK
        whole, share = int(ticks), ticks - int(ticks)
        one, other = (sensed[max(len(sensed) - 1 - whole - k, 0)] for k in (0, 1))
        return {name: (1.0 - share) * value + share * other[name] for name, value in one.items()}

    def _friction(self, v: Array) -> Array:
        rise = 1.0 + RISE * np.exp(-((v / STRIBECK) ** 2))
        return -self.rub * rise * np.tanh(v / SMOOTH) - self.grease * THIN * np.arcsinh(v / THIN)


def _trace(rows: list[dict[str, Array]], vd: float, meta: Mapping[str, str]) -> Trace:
    each = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    zero = np.zeros(len(rows))
    channels = {
        **each,
        "vx_cmd": zero + vd,
        "vy_cmd": zero,
        "wz_cmd": zero,
    }
    units = {
        "q": "rad", "dq": "rad/s", "tau": "N*m", "gyro": "rad/s", "local_linvel": "m/s", "vx": "m/s", "height": "m",
        "vx_cmd": "m/s", "vy_cmd": "m/s", "wz_cmd": "rad/s",
    }  # fmt: skip
    return Trace(TICK * np.arange(len(rows)), channels, units, meta)
