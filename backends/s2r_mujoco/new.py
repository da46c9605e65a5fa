"""The first robot file of a robot: what its files say, and marks where no file says what a rollout needs.

A line that begins with ``# ?`` is such a mark. Nothing of the user runs.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco

from s2r_mujoco.deploy import of_metadata, read_deployment
from s2r_mujoco.deploy.record import TERMS, Deployment
from s2r_mujoco.model import ModelFile
from s2r_mujoco.robot import Robot, open_trained
from s2r_mujoco.start import floors
from s2r_policy import Policy
from s2r_spec.errors import UsageError

USUAL = 0.02
"""Prior: control period of a legged policy [s], proposed where no file states one; every policy in
``shared/robots`` has it."""
_FALL = "max(abs(roll), abs(pitch)) > 60 {deg} or height < 0.6 * init(height)"


def draft(path: Path, model: Path, policy: str, deploy: Path | None) -> tuple[str, tuple[str, ...]]:
    """Return the text of a robot file, and a sentence for each thing that no file states.

    Args:
        path: where the robot file will be; paths in it are relative to its folder.
        model: the MuJoCo model.
        policy: file of the trained policy, ``FILE.py:NAME`` of a controller in Python, or "" for none.
        deploy: the deploy file.

    Raises:
        UsageError: a file is missing, damaged or of another format.
    """
    trained = open_trained(Path(policy)) if policy and ".py:" not in policy else None
    metadata = {} if trained is None else trained.metadata
    stated = read_deployment(deploy) if deploy else of_metadata(metadata, Path(policy).name)
    compiled = ModelFile(model, timestep=None if stated is None else stated.timestep).compile()
    found = [
        *_files(path, model, policy, deploy, trained),
        *_model(compiled, stated),
        *(_policy(compiled, trained, stated) if policy else ()),
        *_rest(compiled, trained, stated),
    ]
    # A name of a stranger's file must not begin a line of its own in the robot file.
    lines = ["".join(one if one.isprintable() else "?" for one in line) for line in found]
    marks = tuple(line.removeprefix("# ? ") for line in lines if line.startswith("# ? "))
    return "\n".join([*lines, ""]), marks


def problem(path: Path) -> str:
    """Return what still keeps a robot file from running; "" if nothing does."""
    try:
        Robot(path)
    except UsageError as error:
        return str(error)
    return ""


def _beside(path: Path, file: str | Path) -> str:
    """Return a path relative to the folder of the robot file, with slashes."""
    return Path(os.path.relpath(file, path.parent)).as_posix()


def _quoted(text: str) -> str:
    """Return a text as a string of TOML, whose escapes are those of JSON."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _files(
    path: Path, model: Path, policy: str, deploy: Path | None, trained: Policy | None
) -> Iterator[str]:
    yield f"# {path.name}, written by `s2r new`; check it with: s2r backends {path.name} --check"
    yield f"model = {_quoted(_beside(path, model))}"
    if not policy:
        yield '# ? policy = "policy.onnx"    or control.py:act, a function act(model, data, command) -> ctrl'
    else:
        width = f"  # {trained.width} numbers in, {trained.outputs} out" if trained and trained.width else ""
        yield f"policy = {_quoted(_beside(path, policy))}{width}"
    if deploy is not None:
        yield f"deploy = {_quoted(_beside(path, deploy))}"


def _model(model: Any, stated: Deployment | None) -> Iterator[str]:
    names = [model.key(number).name for number in range(model.nkey)]
    has_pose = stated is not None and bool(stated.joint_pos)
    if names and not has_pose:
        chosen = "home" if "home" in names else next(filter(None, names), "")
        others = ", ".join(name for name in names if name and name != chosen)
        if chosen:
            yield f"keyframe = {_quoted(chosen)}" + (f"  # others: {others}" if others else "")
    if not model.nu:
        yield "motors = true  # the model has no actuators; a torque motor at each joint, in the model's order"
    if _has_free_base(model) and not floors(model):
        yield "floor = true  # the model has none"
    if stated is not None and stated.step is not None:
        physics = f"physics step {1e3 * model.opt.timestep:g} ms"
        yield f"# {stated.source}: control period {1e3 * stated.step:g} ms; {physics}"
    else:
        steps = max(1, round(USUAL / model.opt.timestep))
        yield (
            f"# ? decimation = {steps}    no file states the control period; {steps} steps of "
            f"{1e3 * model.opt.timestep:g} ms are {1e3 * steps * model.opt.timestep:g} ms"
        )


def _has_free_base(model: Any) -> bool:
    return bool((model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)).any())


def _policy(model: Any, trained: Policy | None, stated: Deployment | None) -> Iterator[str]:
    if trained is None:
        return
    if stated is not None and stated.terms:
        terms = ", ".join(
            f"{one.name}{f' × {one.history}' if one.history > 1 else ''}" for one in stated.terms
        )
        yield f"# {stated.source}: observation {terms}"
    else:
        sensors = [model.sensor(i).name for i in range(model.nsensor) if model.sensor(i).name]
        width = trained.width or "?"
        yield f'# ? observation = ["base_ang_vel"]    no file lists the {width} numbers that the policy takes, in order'
        yield f"#   terms: {', '.join(one for one in TERMS if one not in ('phase', 'sensor'))}"
        yield '#   { phase = 1.5, unit = "Hz", start = [0, 3.14159], as = ["cos", "sin"] }, { sensor = "NAME" }'
        yield from (f"#   sensors: {', '.join(sensors[i : i + 8])}" for i in range(0, len(sensors), 8))
    if stated is None or not stated.action_scale:
        yield "# ? action.scale = 0.5    no file states it; target = default pose + scale * action"
    if (stated is None or not stated.stiffness) and _has_torques(model):
        yield "# ? action.stiffness = 100    the actuators are torques, and no file states gains; also action.damping"


def _has_torques(model: Any) -> bool:
    none = int(mujoco.mjtBias.mjBIAS_NONE)
    plain = bool((model.actuator_biastype == none).any()) and bool((model.actuator_gaintype == 0).any())
    return plain or model.nu == 0


def _rest(model: Any, trained: Policy | None, stated: Deployment | None) -> Iterator[str]:
    terms = () if stated is None else stated.terms
    walks = any(one.name == "velocity_commands" for one in terms) if terms else _has_free_base(model)
    if trained is not None and walks:
        ranges = {} if stated is None else stated.command_ranges
        for name, parameter in (("lin_vel_x", "vd"), ("lin_vel_y", "vy_d"), ("ang_vel_z", "wz_d")):
            limits = ranges.get(name)
            words = f"  # {list(limits)} in {stated.source}" if limits and stated else ""
            yield f'command.{name} = "{parameter}"{words}'
    if _has_free_base(model):
        yield f'failure.fell = "{_FALL}"  # a usual condition, not from a file'
