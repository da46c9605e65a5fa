"""Four equations of a policy's loop, held against a log.

    o_k = terms of (state_k, a_{k−1}, command, k)      a_k = π(o_k)
    T_k = offset + scale · clip(a_k)                   τ_k = kp (T_k − q_k) − kd q̇_k

Each is checked where the log has both sides. What a mistake is, says :mod:`.mistakes`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from s2r_mujoco.arrays import FloatArray
from s2r_mujoco.interface.log import Log, reached, stated_gains
from s2r_mujoco.interface.mistakes import FEWEST, Verdict, judged
from s2r_mujoco.interface.motors import SATURATED
from s2r_mujoco.robot import Robot
from s2r_spec.backend import Finding
from s2r_spec.trace import Trace

GAIN = 0.03
"""Tolerance: relative error of a gain."""
STAMPS = 0.2
"""Tolerance: relative error that messages make which are not of the same instant."""


def loop_findings(robot: Robot, trace: Trace) -> Iterator[Finding]:
    """Yield what a log says of each equation; without a trained policy there is none."""
    if robot.policy is None or robot.parts is None:
        yield Finding("loop", "the controller is a function in Python, whose loop no file states", "note")
        return
    log = Log(robot, trace)
    if not log.is_by_ticks:
        words = f"the log has a row every {1e3 * log.period:.3g} ms, and the control period is"
        yield Finding("loop", f"{words} {1e3 * robot.plan.step:.3g} ms: log one row a tick", "note")
        return
    yield from _observation(log)
    yield from _action(log)
    yield from _target(log)
    yield from _torque(log)


def _observation(log: Log) -> Iterator[Finding]:
    logged, observer = log.channel("obs"), log.observer(log.plan, log.memory(log.plan))
    if logged is None:
        yield Finding("observation", "the log has no obs, so its terms cannot be checked", "note")
        return
    if logged.shape[1] != observer.width:
        yield Finding(
            "observation", f"obs has {logged.shape[1]} columns, and the files make {observer.width}", "wrong"
        )
        return
    made = log.expected(log.plan)
    places = dict(zip((part.name for part in observer.parts), observer.places, strict=True))
    expected = {name: made[:, own] for name, own in places.items() if np.isfinite(made[:, own]).all()}
    unknown = [name for name in places if name not in expected]
    if unknown:
        yield Finding(
            "observation", f"not logged, so not checked: the state behind {', '.join(unknown)}", "note"
        )
    right = []
    for k, part in enumerate(observer.parts):
        if part.name not in expected:
            continue
        own = places[part.name]
        others = {name: values for name, values in expected.items() if name != part.name}
        if part.term.name == "joint_pos_rel":
            whole = replace(part.term, name="joint_pos")
            terms = (*log.plan.terms[:k], whole, *log.plan.terms[k + 1 :])
            values = log.expected(replace(log.plan, terms=terms))[:, own]
            others["the positions without the default pose subtracted"] = values
        turn = log.attitude if part.senses in ("vector", "angular") else None
        # At t = 0 the last action and a history begin by rules of the files, which a log need not share.
        found = judged(
            part.name, expected[part.name][1:], logged[1:, own], log.names(part),
            {name: values[1:] for name, values in others.items()}, None if turn is None else turn[1:],
        )  # fmt: skip
        if found.holds:
            right.append(part.name)
        else:
            yield _finding(log, "observation", part.name, replace(found, since=found.since + 1))
    if right:
        yield Finding("observation", f"as the files say: {', '.join(right)}")


def _action(log: Log) -> Iterator[Finding]:
    observed, action, policy = log.channel("obs"), log.channel("action"), log.robot.policy
    assert policy is not None
    if observed is None or action is None or observed.shape[1] != policy.width:
        return
    if policy.recurrent and abs(float(log.trace.times[0])) > 1e-9:
        words = f"the policy has a state, which is unknown before t = {log.trace.times[0]:g} s"
        yield Finding("action", f"{words}; log from the reset on", "note")
        return
    policy.reset()
    made = np.array([policy(row) for row in observed.astype(np.float32)], dtype=np.float64)
    names = [log.plan.joints.names[k] for k in log.plan.law.moved]
    found = judged("action", made, action, names)
    yield _finding(log, "action", "action", found, "the policy returns it for the logged observations")


def _target(log: Log) -> Iterator[Finding]:
    action, law, joints = log.channel("action"), log.plan.law, log.plan.joints
    order = np.argsort(joints.qpos)
    target = log.channel("target")
    if action is None or target is None or target.shape[1] != len(joints):
        return
    clipped = action if law.clip_action is None else np.clip(action, *law.clip_action)
    made = law.targets(clipped, log.plan.pose)
    names = [joints.names[k] for k in order]
    found = judged("target", made[:, order], target, names)
    if not found.holds and (found.mistake is None or found.mistake.kind != "late"):
        # A factor of the action is not one of the target, which has an offset.
        rest = judged(
            "target − offset", (made - log.plan.pose)[:, order], target - log.plan.pose[order], names
        )
        found = rest if rest.mistake is not None and rest.left < found.left else found
    yield _finding(log, "target", "target", found, "offset + scale · action, as the files say")


def _torque(log: Log) -> Iterator[Finding]:
    """Yield the gains that a log shows, by least squares of τ on T − q and q̇, joint by joint."""
    order = np.argsort(log.plan.joints.qpos)
    target = log.channel("target")
    if target is None or target.shape[1] != len(order) or (fits := _gain_fits(log, target)) is None:
        return
    stated, wrong = stated_gains(log.robot.model, log.plan)[order], []
    back = int(np.argmin([fit[:, 2].sum() for fit in fits]))
    shown = np.flatnonzero(np.isfinite(fits[back][:, 0]))
    for k, (kp, kd, _) in zip(shown, fits[back][shown], strict=True):
        far = [
            abs(one - other) > GAIN * max(other, 1e-9) for one, other in zip((kp, kd), stated[k], strict=True)
        ]
        if far[0] or (far[1] and stated[k][1] > 0.0):
            damped = f", kd {kd:.3g} for {stated[k][1]:.3g}" if stated[k][1] > 0.0 else ""
            wrong.append(f"{log.plan.joints.names[order[k]]}: kp {kp:.3g} for {stated[k][0]:.3g}{damped}")
    words = f"kp (target − q) − kd q̇{', with the target of the tick before,' if back else ''}"
    if wrong:
        yield Finding("torque", f"{words} holds with other gains", "wrong", tuple(wrong))
    elif shown.size:
        yield Finding("torque", f"{words} with the stated gains")


def torque_is_before(logs: Sequence[Log]) -> bool:
    """Return whether logged torques follow from the target of the tick before, as states of a robot's motors do.

    Targets that a log lacks are those of the policy on its state.
    """
    from s2r_mujoco.interface.replay import actions, lacking

    left = np.zeros(2)
    for log in logs:
        target, plan = log.channel("target"), log.plan
        trained = log.robot.policy is not None  # a controller in Python reads the model itself
        if target is None and trained and log.is_by_ticks and not lacking(log):
            target = plan.law.targets(log.limited(actions(log, plan)), plan.pose)[
                :, np.argsort(plan.joints.qpos)
            ]
        if target is not None and (fits := _gain_fits(log, target)) is not None:
            left += [fit[:, 2].sum() for fit in fits]
    return bool(left[1] < left[0])


def _gain_fits(log: Log, target: FloatArray) -> list[FloatArray] | None:
    """Return for (n, J) targets of the tick, and of the tick before, (J, 3) kp, kd and the squares that they leave.

    kp and kd are NaN where a joint does not show them. There is no fit where the log lacks the state or the torques.
    """
    joints, law = log.plan.joints, log.plan.law
    order = np.argsort(joints.qpos)
    names = [joints.names[k] for k in order]
    position, speed, torque = (log.joints(name, names) for name in ("q", "dq", "tau"))
    if position is None or speed is None or torque is None:
        return None
    able = (law.has_target & ~law.speed & np.isfinite(stated_gains(log.robot.model, log.plan)).all(axis=1))[
        order
    ]
    target = reached(log.robot.model, log.plan, target[:, np.argsort(order)])[:, order]
    fits = []
    for back in (0, 1):
        rows, sent = slice(back, None), target[: len(target) - back]
        fit = np.tile([np.nan, np.nan, 0.0], (len(order), 1))
        for k in np.flatnonzero(able):
            fit[k] = _fit(sent[:, k] - position[rows, k], speed[rows, k], torque[rows, k])
        fits.append(fit)
    return fits


def _fit(error: FloatArray, speed: FloatArray, torque: FloatArray) -> tuple[float, float, float]:
    """Return kp, kd and the sum of squares that they leave, by least squares where the torque is below its limit."""
    free = np.abs(torque) < SATURATED * np.abs(torque).max(initial=0.0)
    x = np.stack([error, -speed], axis=1)[free]
    if len(x) < FEWEST or np.linalg.matrix_rank(x) < 2:
        return np.nan, np.nan, 0.0
    gains = np.linalg.lstsq(x, torque[free], rcond=None)[0]
    return float(gains[0]), float(gains[1]), float(np.sum((torque[free] - x @ gains) ** 2))


def _finding(log: Log, topic: str, name: str, found: Verdict, right: str = "") -> Finding:
    """Return the finding of an equation; ``right`` are the words of one that holds."""
    if found.holds:
        return Finding(topic, right)
    share = found.error / max(found.size, 1e-12)
    since = "" if found.since <= 1 else f" from t = {log.trace.times[found.since]:g} s on"
    off = f"off by {100.0 * share:.3g} % of its rms"
    if found.mistake is not None:
        row = f"{found.mistake.equation}; as the files say, {name} is {off}"
        certain = found.mistake.kind not in ("late", "constant")  # delays and offsets are physics, too
        return Finding(topic, f"{name} {found.mistake.words}{since}", "wrong", (row,), certain)
    if share <= STAMPS:
        words = f"{name} is nearly as the files say, as where messages of one tick have no common stamp"
        return Finding(topic, words, "note", (f"{name} is {off}",))
    words = f"{name} is not as the files say{since}, and no simple mistake explains it"
    return Finding(topic, words, "wrong", (f"{name} is {off}",))
