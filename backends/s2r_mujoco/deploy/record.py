"""What deploy files say of a policy: the observation that it gets, and what its actions mean.

One record for all formats; :mod:`s2r_mujoco.deploy` reads each format into it. Three orders occur:

- policy order: joint i is element i of the action and of each joint term of the observation;
- motor order: the order of the controller's motors, and of a MuJoCo model's actuators;
- ``motors[i]`` is the motor of policy joint i.

Every list of a :class:`Deployment` is in policy order. Angles are in rad, gains in N·m/rad and N·m·s/rad.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

TERMS = (
    "base_lin_vel",
    "base_ang_vel",
    "projected_gravity",
    "joint_pos_rel",
    "joint_pos",
    "joint_vel_rel",
    "joint_vel",
    "last_action",
    "velocity_commands",
    "phase",
    "sensor",
)
"""Definition: names of the terms that have a meaning of their own, as Isaac Lab uses them."""


MOST_HISTORY = 1000
"""Budget: observations that a term keeps; 20 s at 50 Hz."""
MOST_JOINTS = 1000
"""Budget: joints of a policy."""


@dataclass(frozen=True)
class Term:
    """One part of an observation.

    The value is clipped and scaled, in the order that ``clip_first`` says, and then kept for the history. A term of
    n components with a history of k observations has n·k elements.
    """

    name: str  # one of TERMS, a user's "file.py:function", or a name of the file that has no meaning here
    scale: tuple[float, ...] = ()  # () none, one number, or one a component
    clip: tuple[float, float] | None = None
    clip_first: bool = True  # clip before scale (Isaac Lab), else after
    history: int = 1  # observations, oldest first unless newest_first
    newest_first: bool = False
    sensor: str = ""  # name of a MuJoCo sensor
    frequency: float = 0.0  # of a phase [Hz]
    start: tuple[float, ...] = ()  # each phase at the first observation [rad]
    parts: tuple[str, ...] = ()  # "sin", "cos", in this order, each over all phases
    frame: str = "body"  # or "world", or a site
    joints: tuple[int, ...] = ()  # indices in policy order of a joint term; () all of them
    names: tuple[str, ...] = ()  # instead: joints of the model, by regular expressions
    order: tuple[int, ...] = ()  # component i of the term is component order[i] of what it is named for
    late: int = 0  # control ticks by which its value is older than the tick
    group: str = ""  # the policy's input that has this term; "" where the policy has one
    source: str = ""  # place in the file, for messages: "deploy.yaml: observations.base_ang_vel"


@dataclass(frozen=True)
class Deployment:
    """What the files say; empty or None where they say nothing.

    The target of joint i is ``action_offset[i] + action_scale[i] · action[i]``: a velocity [rad/s] for
    ``velocity_joints``, whose position target stays at ``joint_pos``; else a position [rad].
    """

    source: str  # file names, for messages
    format: str = ""  # "unitree", "rl_sar", "unitree_rl_gym", "onnx"
    joints: tuple[str, ...] = ()  # names
    motors: tuple[int, ...] = ()  # policy joint i is motor motors[i]; () where both orders are the same
    joint_pos: tuple[float, ...] = ()  # default pose [rad]
    stiffness: tuple[float, ...] = ()  # [N·m/rad]
    damping: tuple[float, ...] = ()  # [N·m·s/rad]
    torque_limit: tuple[float, ...] = ()  # [N·m]
    step: float | None = None  # control period [s]
    timestep: float | None = None  # physics step [s]
    terms: tuple[Term, ...] = ()
    history_by: str = "term"  # each term with its history; or "time": each observation with all terms
    history_start: str = "first"  # begins filled with the first observation, or with "zero"
    observation_clip: tuple[float, float] | None = None  # of the whole observation, after the terms' own
    action_scale: tuple[float, ...] = ()
    action_offset: tuple[float, ...] = ()  # [rad]; () where the file leaves it out
    action_clip: tuple[tuple[float, float], ...] = ()
    action_clip_first: bool = False  # clips the policy's output, and last_action; else the target
    action_joints: tuple[int, ...] = ()  # indices in policy order that the action moves; () all of them
    velocity_joints: tuple[int, ...] = ()  # indices in policy order whose target is a velocity
    # motor that holds one position: that [rad], stiffness and damping
    held: Mapping[int, tuple[float, float, float]] = field(default_factory=dict)
    command_ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    command_scale: tuple[float, ...] = ()  # as the term velocity_commands has it
    policy: str = ""  # path as the file writes it
    model: str = ""
    files: tuple[Path, ...] = ()  # for hashes
    unused: tuple[str, ...] = ()  # keys of the files that have no meaning here: "section.key"

    def without_observation(self) -> Deployment:
        """Return what the files say of the joints alone: a robot in the air has no policy, and no attitude."""
        return replace(self, terms=(), command_ranges={})

    def actuators(self, count: int) -> tuple[int, ...]:
        """Return the actuator of each policy joint in a model that has ``count`` actuators in motor order.

        A file may number motors with gaps (a G1 of 23 joints has motors up to 26). A model has either all motors, or
        only those of the policy without gaps. In unitree_rl_gym a model of the policy's joints alone has them in policy
        order, whatever their motors are (``qpos[7:]`` in deploy_mujoco.py).

        Raises:
            ValueError: a model of this many actuators fits neither way.
        """
        motors = self.motors or tuple(range(len(self.joints) or len(self.joint_pos)))
        if count == len(motors) and self.format == "unitree_rl_gym":
            return tuple(range(count))
        if max(motors, default=-1) < count:
            return motors
        if count == len(motors):
            return ranks(motors)
        raise ValueError(
            f"{self.source} has {len(motors)} joints, up to motor {max(motors)}; the model has {count} actuators"
        )


def ranks(motors: tuple[int, ...]) -> tuple[int, ...]:
    """Return the place of each motor among those of the policy: (15, 0, 12) → (2, 0, 1)."""
    place = {motor: rank for rank, motor in enumerate(sorted(motors))}
    return tuple(place[motor] for motor in motors)
