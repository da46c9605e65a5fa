"""The pre-flight of a robot file: what its files say together, and what shows in a few rollouts.

Each line names the key or the file that it is about. None of it is a certificate.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from time import perf_counter
from typing import Any

import mujoco
import numpy as np

from s2r_mujoco.arrays import FloatArray
from s2r_mujoco.description import COMMANDS
from s2r_mujoco.law import servo_gains
from s2r_mujoco.robot import STABLE, Robot
from s2r_mujoco.rollout import Record
from s2r_mujoco.running import Running
from s2r_spec.backend import Finding, Parameter
from s2r_spec.trace import Trace

STILL = 0.01
"""Definition: a velocity term that never exceeds this during a commanded motion is named [in the unit of the term]."""
STANDING = 5.0
"""Budget: simulated time of standing without a command [s]."""
SUNK = 0.5
"""Definition: share of its height at the start below which a robot without a failure condition does not stand."""
TIPPED = 60.0
"""Definition: tilt beyond which a robot without a failure condition has fallen [deg]."""
TRIED = 0.5
"""Prior: forward command where neither a file nor a specification states a range [m/s]."""
SETTLED = 2.0
"""Budget: time before a motion's velocity is measured [s]."""
SLOW = 0.5
"""Definition: share of a command below which a robot does not follow it; one that exceeds it by as much is named."""
CALLS = 50
"""Budget: calls of a policy that are timed."""
DEGREES = 180.0 / np.pi


def findings(robot: Robot, parameters: Sequence[Parameter]) -> Iterator[Finding]:
    """Yield what needs no rollout: files, observation, joints, control period, stability of the gains."""
    yield _files(robot)
    yield from _observation(robot)
    yield _joints(robot)
    yield from _left(robot)
    yield from _stability(robot)
    yield from _lacking(robot, parameters)


def trials(running: Running, parameters: Sequence[Parameter]) -> Iterator[Finding]:
    """Yield what shows in two rollouts: standing without a command, and moving at the highest one."""
    robot = running.robot
    values = {one.name: one.default for one in parameters}
    ticks = round(STANDING / robot.plan.step) + 1
    running.prepare(values)
    standing = running.run(values, 0, ticks, command=dict.fromkeys(COMMANDS, 0.0))
    yield from _first_action(robot, values, standing)
    if robot.plan.root >= 0:
        yield _stands(robot, standing)
    moving = running.run(dict(values) | _highest(robot, parameters), 0, ticks)
    if robot.plan.root >= 0 and moving.command.any():
        yield _moves(robot, moving)
    yield from _torque(robot, moving)
    yield _speed(robot, standing)
    yield from _ranges(running, values, moving, bool(moving.command.any()))
    yield from _without_effect(running, dict(values) | _highest(robot, parameters), moving)


def _highest(robot: Robot, parameters: Sequence[Parameter]) -> dict[str, float]:
    """Return the highest command of each component; a forward one where no range is known."""
    component = {one.parameter: name for name, one in robot.plan.commands.items()}
    known = {one.name: one.high for one in parameters if one.name in component and one.low < one.high}
    forward = [one.name for one in parameters if component.get(one.name) == "lin_vel_x"]
    return known or dict.fromkeys(forward, TRIED)


def _without_effect(running: Running, values: Mapping[str, float], moving: Record) -> Iterator[Finding]:
    """Yield a note for each parameter whose other values change no bit of a rollout."""
    commands = {one.parameter for one in running.robot.plan.commands.values()}
    for name, one in running.robot.parameters.items():
        low, high = one.declared.low, one.declared.high
        if low == high or name in commands:
            continue
        other = running.run({**values, name: low if values[name] == high else high}, 0, len(moving))
        if np.array_equal(other.qpos[-1], moving.qpos[-1]):
            yield Finding("parameters", f"{name} changes nothing within {STANDING:g} s", "note")


def _files(robot: Robot) -> Finding:
    table = robot.description.table
    kind = "controller in Python" if robot.policy is None else "policy"
    state = ", recurrent: reset at t = 0" if robot.policy is not None and robot.policy.recurrent else ""
    words = [f"model {robot.file.path.name}", f"{kind} {table.policy}{state}"]
    if robot.deployment.files:
        words.append(f"deploy file {robot.deployment.source}")
    own = ", ".join(path.name for path in robot.code_files)
    runs = f"Python files that run: {own}" if own else ""
    notes = () if robot.policy is None else robot.policy.notes
    return Finding("files", "; ".join(filter(None, [*words, runs, *notes])))


def _observation(robot: Robot) -> Iterator[Finding]:
    if robot.policy is None:
        return
    if robot.parts is None:
        yield Finding("observation", "its width shows in a rollout, since a term is a function of the user")
        return
    terms = ", ".join(
        f"{p.name} {p.width}{f' × {p.term.history}' if p.term.history > 1 else ''}" for p in robot.parts
    )
    total = sum(part.width * part.term.history for part in robot.parts)
    known = "as the policy takes" if robot.policy.width else "the policy does not say how many it takes"
    yield Finding("observation", f"{total} numbers, {known}: {terms}", "ok" if robot.policy.width else "note")
    for part in robot.parts:
        if any(
            abs(abs(scale) / degrees - 1) < 0.01
            for scale in part.term.scale
            for degrees in (DEGREES, 1 / DEGREES)
        ):
            yield Finding(
                "observation",
                f"{part.term.source}: the scale {part.term.scale[0]:g} turns rad into deg, or back",
                "note",
            )


def torque_limits(robot: Robot) -> FloatArray:
    """Return (n,) the largest torque or force of each joint; inf without a limit."""
    model, joints = robot.model, robot.plan.joints
    found = []
    for i, (actuator, dof) in enumerate(zip(joints.actuators, joints.dof, strict=True)):
        gear, joint = abs(model.actuator_gear[actuator, 0]), model.dof_jntid[dof]
        limits = [robot.plan.law.torque_limit[i]]
        if model.actuator_forcelimited[actuator]:
            limits.append(gear * np.abs(model.actuator_forcerange[actuator]).max())
        if model.jnt_actfrclimited[joint]:
            limits.append(np.abs(model.jnt_actfrcrange[joint]).max())
        if model.actuator_ctrllimited[actuator] and robot.plan.law.kind[i] == "torque":
            gain = abs(model.actuator_gainprm[actuator, 0])
            limits.append(gear * gain * np.abs(model.actuator_ctrlrange[actuator]).max())
        found.append(min(limits))
    return np.array(found)


def _joints(robot: Robot) -> Finding:
    plan, model = robot.plan, robot.model
    kp, kd = servo_gains(model, plan.law, plan.joints)
    ratio, limits = robot.damping_ratio(kd), torque_limits(robot)
    width = max(len(name) for name in plan.joints.names)
    rows = [f"policy  {'joint':{width}}  actuator      kp      kd  default           limits  torque  kd·dt/M"]
    for i, name in enumerate(plan.joints.names):
        low, high = plan.joints.low[i], plan.joints.high[i]
        rows.append(
            f"{i:6d}  {name:{width}}  {plan.joints.actuators[i]:8d}  {kp[i]:6.4g}  {kd[i]:6.4g}  {plan.pose[i]:7.3f}  "
            f"[{low:6.3f}, {high:6.3f}]  {limits[i]:6.4g}  {ratio[i]:7.3g}"
        )
    gain = {
        "model": "the model's actuators",
        "explicit": "gains at every physics step",
        "implicit": "gains in MuJoCo",
    }
    period = f"control every {1e3 * plan.step:g} ms, physics every {1e3 * model.opt.timestep:g} ms"
    return Finding(
        "joints",
        f"{len(plan.joints)} of the policy; torques by {gain[plan.law.pd]}; {period}",
        table=tuple(rows),
    )


def _stability(robot: Robot) -> Iterator[Finding]:
    law = robot.plan.law
    ratio = robot.damping_ratio(law.damping)
    if law.pd == "model" or "torque" not in law.kind or ratio.max() < STABLE:
        return
    worst, count = int(np.argmax(ratio)), int((ratio >= STABLE).sum())
    words = (
        f"torques from gains at every physics step are unstable at {count} joints: kd·dt/M must stay below 2, and is "
        f"{ratio[worst]:.3g} at {robot.plan.joints.names[worst]}"
    )
    if law.pd == "explicit":
        yield Finding("gains", f'{words}; write action.pd = "implicit"', "wrong")
    else:
        yield Finding("gains", f'{words}; so MuJoCo computes them (action.pd = "implicit")', "note")


def _left(robot: Robot) -> Iterator[Finding]:
    """Yield the actuators that the policy leaves alone, and a control period that differs from the deploy file's."""
    plan, model, stated = robot.plan, robot.model, robot.deployment.step
    held = plan.held.joints
    if len(held):
        yield Finding("held", f"{len(held)} joints beside the policy's: {', '.join(held.names)}")
    left = sorted({*range(model.nu)} - {*plan.joints.actuators.tolist(), *held.actuators.tolist()})
    if left and robot.policy is not None:
        names = ", ".join(model.actuator(i).name or f"actuator {i}" for i in left)
        control = "the keyframe's control" if plan.key >= 0 else "their start position, or no force"
        yield Finding(
            "actuators", f"{len(left)} that the policy does not move keep {control}: {names}", "note"
        )
    pairs = zip(robot.deployment.joints, plan.joints.names, strict=False)
    other = [f"{name} is {own}" for name, own in pairs if name != own]
    if other:
        words = f"{len(other)} joints of {robot.deployment.source} have another name in the model"
        yield Finding("joints", f"{words}: {', '.join(other)}", "note")
    if stated is not None and abs(plan.step - stated) > 1e-6 * stated:
        words = f"control every {1e3 * plan.step:g} ms by decimation, not every {1e3 * stated:g} ms as in"
        yield Finding("period", f"{words} {robot.deployment.source}", "note")


def _lacking(robot: Robot, parameters: Sequence[Parameter]) -> Iterator[Finding]:
    if robot.plan.root >= 0 and not robot.description.table.failure:
        words = 'no condition tells a fall; write failure.fell = "height < 0.6 * init(height)"'
        yield Finding("failure", words, "note")
    reads = robot.policy is None or any(
        term.name == "velocity_commands" or ".py:" in term.name for term in robot.plan.terms
    )
    given = [name for name, one in robot.plan.commands.items() if one.parameter or one.value]
    if given and not reads:
        words = f"command.{given[0]} has no effect, since the policy reads no velocity_commands"
        yield Finding("command", words, "wrong")
    for one in parameters:
        if one.low == one.high:
            words = (
                f"no file states the range of {one.name}, so a specification must; here it is {one.default:g}"
            )
            yield Finding("parameters", f"{words} {one.unit}".rstrip(), "note")
    if robot.deployment.unused:
        yield Finding("deploy", f"keys that are not used: {', '.join(robot.deployment.unused)}", "note")


def _first_action(robot: Robot, values: Mapping[str, float], record: Record) -> Iterator[Finding]:
    plan = robot.plan
    if robot.policy is None or not plan.law.has_target.any():
        return
    start = record.qpos[0, plan.joints.qpos]
    moved = np.where(plan.law.has_target & ~plan.law.speed, np.abs(record.target[0] - start), 0.0)
    worst = int(np.argmax(moved))
    outside = (record.target[0] < plan.joints.low) | (record.target[0] > plan.joints.high)
    words = f"the first target is {moved[worst]:.2g} rad from the start pose at most, at {plan.joints.names[worst]}"
    if outside[worst]:
        limits = f"[{plan.joints.low[worst]:.3g}, {plan.joints.high[worst]:.3g}]"
        yield Finding(
            "start", f"{words}, and outside its limits {limits}; check default pose and scale", "note"
        )
    else:
        yield Finding("start", words)


def _tilt(trace: Trace) -> FloatArray:
    """Return (n,) the angle between the base's and the world's vertical [deg]."""
    tilt: FloatArray = np.degrees(np.arccos(np.clip(-trace["gravity"][:, 2], -1.0, 1.0)))
    return tilt


def _end(robot: Robot, record: Record, trace: Trace) -> str:
    """Return how a rollout ends early, or lies at its end; "" if it does neither."""
    failure, height, tilt = robot.failures.first(trace), trace["z"], _tilt(trace)
    if record.unstable or failure is not None:
        name, tick = ("unstable", len(record) - 1) if failure is None else failure
        return f"it ends at {tick * robot.plan.step:.2f} s: {name}"
    if tilt.max() > TIPPED:
        return f"it tips over at {int(np.argmax(tilt > TIPPED)) * robot.plan.step:.2f} s"
    if height[-1] < SUNK * height[0]:
        return f"it sinks from {height[0]:.3f} to {height[-1]:.3f} m"
    return ""


def _stands(robot: Robot, record: Record) -> Finding:
    trace = robot.trace(record, {})
    if end := _end(robot, record, trace):
        return Finding("stand", f"without a command {end}", "wrong")
    ends, tilt = f"{trace['z'][0]:.3f} to {trace['z'][-1]:.3f}", _tilt(trace).max()
    return Finding("stand", f"{STANDING:g} s without a command: height {ends} m, tilt at most {tilt:.2g} deg")


def _moves(robot: Robot, record: Record) -> Finding:
    """Return whether the robot follows the highest command: its mean velocity once it has settled."""
    command = ", ".join(
        f"{name} = {value:g} {unit}"
        for (name, unit), value in zip(COMMANDS.items(), record.command, strict=True)
        if value
    )
    trace, late = robot.trace(record, {}), slice(round(SETTLED / robot.plan.step), None)
    if end := _end(robot, record, trace):
        return Finding("move", f"with {command} {end}", "wrong")
    mean = np.array([trace[name][late].mean() for name in ("vx", "vy", "wz")])
    wanted = np.flatnonzero(record.command)
    share = mean[wanted] / record.command[wanted]
    units = [*COMMANDS.values()]
    words = ", ".join(f"{mean[i]:.3g} {units[i]}" for i in wanted)
    return Finding(
        "move",
        f"with {command} it moves at {words} from {SETTLED:g} s on",
        "wrong" if share.min() < SLOW else "note" if share.max() > 2 - SLOW else "ok",
    )


def _torque(robot: Robot, record: Record) -> Iterator[Finding]:
    joints, limits = robot.plan.joints, torque_limits(robot)
    share = np.abs(record.torque[:, joints.dof]) / limits
    if not np.isfinite(limits).any():
        yield Finding("torque", "no file limits a torque", "note")
        return
    worst = int(np.argmax(share.max(axis=0)))
    full = float((share[:, worst] > 1 - 1e-6).mean())
    words = f"{100 * share[:, worst].max():.0f} % of the limit at most, at {joints.names[worst]}"
    if full:
        words += f", which is at its limit in {100 * full:.0f} % of the ticks"
    yield Finding("torque", words, "note" if full else "ok")


def _speed(robot: Robot, record: Record) -> Finding:
    if robot.policy is None:
        return Finding("time", "the controller is a function in Python")
    began = perf_counter()
    for _ in range(CALLS):
        robot.policy(record.observation[0])
    each = (perf_counter() - began) / CALLS
    robot.policy.reset()
    period = robot.plan.step
    words = f"the policy takes {1e6 * each:.0f} µs here, {100 * each / period:.2g} % of the control period"
    return Finding("time", words, "wrong" if each > period else "ok")


def _ranges(
    running: Running, values: Mapping[str, float], record: Record, commanded: bool
) -> Iterator[Finding]:
    robot = running.robot
    if robot.policy is None:
        return
    observer = running.simulator(values).observer
    rows, still = [f"{'term':24}  {'least':>9}  {'greatest':>9}  as the policy reads it"], []
    for part, place in zip(observer.parts, observer.places, strict=True):
        seen = record.observation[:, place]
        name = part.name
        rows.append(f"{name:24}  {seen.min():9.3g}  {seen.max():9.3g}")
        if _is_velocity(robot.model, part.term) and commanded and np.abs(seen).max() < STILL:
            still.append(name)
    yield Finding("terms", "their ranges over one rollout", table=tuple(rows))
    for name in still:
        yield Finding("terms", f"{name} stays below {STILL:g} while the robot is commanded to move", "wrong")


def _is_velocity(model: Any, term: Any) -> bool:
    if term.sensor:
        kinds = {int(mujoco.mjtSensor.mjSENS_VELOCIMETER), int(mujoco.mjtSensor.mjSENS_GYRO)}
        return int(model.sensor(term.sensor).type[0]) in kinds
    return term.name in ("base_lin_vel", "base_ang_vel", "joint_vel", "joint_vel_rel")
