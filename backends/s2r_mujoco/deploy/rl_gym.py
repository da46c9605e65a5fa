"""Read the yaml files of unitree_rl_gym: deploy_mujoco/configs and deploy_real/configs.

The observation is always the same: angular velocity, gravity, command, joint positions, joint velocities, last
action, sine and cosine of a phase of 0.8 s. Joints are in the order of the model, or of ``leg_joint2motor_idx``.
Source: deploy/deploy_mujoco/deploy_mujoco.py and deploy/deploy_real/deploy_real.py.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import pi
from pathlib import Path

from s2r_mujoco.deploy.record import MOST_JOINTS, Deployment, Term
from s2r_mujoco.deploy.section import Section

PERIOD = 0.8
"""Definition: period of the phase in both scripts [s]."""
MOST_STEPS = 100_000
"""Budget: physics steps a control step."""
_PER = "one an action by num_actions"


def fits(values: Mapping[str, object]) -> bool:
    """Return whether these are the keys of a file of unitree_rl_gym."""
    return {"default_angles", "kps", "num_actions"} <= values.keys()


def deployment(values: Mapping[str, object], path: Path) -> Deployment:
    """Return what a file of unitree_rl_gym says.

    Raises:
        UsageError: a key is missing, a list has another length than ``num_actions``, or ``num_obs`` does not fit.
    """
    file = Section(values, path.name)
    count = file.whole("num_actions", 1, MOST_JOINTS)
    width = 3 + 3 + 3 + 3 * count + 2
    if file.has("num_obs") and file.number("num_obs") != width:
        file.fail(
            "num_obs", f"is {file.number('num_obs'):g}; the observation of this format has {width} numbers"
        )
    timestep = file.number("simulation_dt", positive=True) if file.has("simulation_dt") else None
    if timestep:
        step = timestep * file.whole("control_decimation", 1, MOST_STEPS)
    else:
        step = file.number("control_dt", positive=True)
    command = file.numbers("cmd_scale", 3, "one for each of x, y and yaw")
    default = file.numbers("default_angles", count, _PER)
    motors = file.indices("leg_joint2motor_idx") if file.has("leg_joint2motor_idx") else ()
    if motors and len(motors) != count:
        file.fail("leg_joint2motor_idx", f"has {len(motors)} indices instead of {count}, {_PER}")
    found = Deployment(
        source=path.name,
        format="unitree_rl_gym",
        motors=motors if motors != tuple(range(count)) else (),
        joint_pos=default,
        stiffness=file.gains("kps", count, _PER),
        damping=file.gains("kds", count, _PER),
        step=step,
        timestep=timestep,
        terms=_terms(file, step, command),
        action_scale=file.spread("action_scale", count, _PER),
        action_offset=default,
        held=_held(file),
        command_ranges=_ranges(file),
        command_scale=command,
        policy=file.text("policy_path"),
        model=file.text("xml_path"),
        files=(path,),
    )
    return replace(found, unused=file.unused())


def _terms(file: Section, step: float, command: tuple[float, ...]) -> tuple[Term, ...]:
    """Return the terms; the counter of the phase is one control step at the first observation."""
    phase = Term("phase", frequency=1 / PERIOD, start=(2 * pi * step / PERIOD,), parts=("sin", "cos"))
    return (
        Term("base_ang_vel", _scale(file, "ang_vel_scale"), source=file.place("ang_vel_scale")),
        Term("projected_gravity", source=file.source),
        Term("velocity_commands", command, source=file.place("cmd_scale")),
        Term("joint_pos_rel", _scale(file, "dof_pos_scale"), source=file.place("dof_pos_scale")),
        Term("joint_vel", _scale(file, "dof_vel_scale"), source=file.place("dof_vel_scale")),
        Term("last_action", source=file.source),
        replace(phase, source=file.source),
    )


def _scale(file: Section, key: str) -> tuple[float, ...]:
    scale = file.number(key)
    return () if scale == 1.0 else (scale,)


def _held(file: Section) -> dict[int, tuple[float, float, float]]:
    """Return the motors of arms and waist, which hold a position on the real robot."""
    if not file.has("arm_waist_joint2motor_idx"):
        return {}
    motors = file.indices("arm_waist_joint2motor_idx")
    per = "one a motor of arm_waist_joint2motor_idx"
    targets = file.numbers("arm_waist_target", len(motors), per)
    kp, kd = (file.gains(f"arm_waist_{key}", len(motors), per) for key in ("kps", "kds"))
    return dict(zip(motors, zip(targets, kp, kd, strict=True), strict=True))


def _ranges(file: Section) -> dict[str, tuple[float, float]]:
    """Return the commands' limits of a file for the real robot: the joystick's largest command."""
    if not file.has("max_cmd"):
        return {}
    most = file.gains("max_cmd", 3, "one for each of x, y and yaw")
    return {key: (-one, one) for key, one in zip(("lin_vel_x", "lin_vel_y", "ang_vel_z"), most, strict=True)}
