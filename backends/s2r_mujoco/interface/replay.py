"""Which loop makes the policy do what a log shows, on the state that the log has?

Data: of n ticks the state behind every term of the observation, and an output y (n, J) of the loop: the action, the
targets, or the torques, whichever the log has first. Unknown: the loop s, that of the files or one of
:mod:`.switches`. Model:

    a_k = π(o_k(s)),   o_k(s) from the logged state and a_{k−1};   T_k = targets of a_k by s
    y_k = a_k with the T_k of the logged action, or T_k, or κ_j (T_{k−d} − q_k) − δ_j q̇_k + c_j of joint j
    y_kj = ŷ_kj(s) + ε_kj,   ε_kj ~ N(0, σ_j²)

The last action is the policy's own, so the loop runs from the first tick. Another gain, a delay and a lag are physics.
So κ_j and δ_j are around the stated gains, all with one error, and c_j around 0. The delay d, with or without jitter,
the lag and the age of the logged state are the best ones. σ_j has the density 1/σ_j. A loop in which all that is
measured is late is one of physics, too.

Estimator: ℓ(s) = −½ N Σ_j log(RSS_j(s)/n + r²) + log p(κ, δ, c), N = n (1 − ρ)/(1 + ρ) independent ticks, ρ the
correlation of neighbouring residuals of the best loop, and r the rounding of the log with the error of a motor's law.
Before, the loop of the files is as likely as all others together. A second mistake is looked for beside the best first
one.

Units: those of y. Shapes: n ticks, J joints. Source: Gelman et al., *Bayesian Data Analysis* (2013), ch. 3 (σ unknown).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from s2r_mujoco.arrays import FloatArray
from s2r_mujoco.interface.log import Log, reached, stated_gains
from s2r_mujoco.interface.mistakes import FEWEST, rounding
from s2r_mujoco.interface.motors import Motors, log_squares
from s2r_mujoco.interface.switches import Switch, delayed, switches
from s2r_mujoco.plan import Plan
from s2r_mujoco.robot import Robot
from s2r_spec.backend import LoopMistake, Replayed

MOTOR = 0.01
"""Tolerance: part of the torques' rms by which motors differ from the law of their gains."""
FIRST = 3
"""Budget: first mistakes beside which a second one is looked for, where there is one."""
EXPLAINED = 0.05
"""Tolerance: part of the output's rms that a loop may leave, to explain it."""
SURE = 0.95
"""Level: probability from which on a loop is named."""
LOGS = 3
"""Budget: logs on whose state loops run; a run of the Go1 of 5 s takes a loop 10 ms."""
FAR = 1e6
"""Definition: stands for an action that is no number: the loop explains nothing there."""


@dataclass(frozen=True)
class Output:
    """What the loop gave out: name of the channel, (n, J) values, and beside an action the targets that it became."""

    name: str
    values: FloatArray
    target: FloatArray | None = None

    @classmethod
    def of(cls, log: Log) -> Output | None:
        """Return the action, the targets or the torques of a log, in this order; None where it has none."""
        plan = log.plan
        names = [plan.joints.names[k] for k in np.argsort(plan.joints.qpos)]
        action, target, torque = log.channel("action"), log.channel("target"), log.joints("tau", names)
        target = None if target is None or target.shape[1] != len(names) else target
        if action is not None and action.shape[1] == len(plan.law.moved):
            return cls("action", action, target)
        if target is not None:
            return cls("target", target)
        state = log.joints("q", names), log.joints("dq", names)
        return None if torque is None or any(one is None for one in state) else cls("tau", torque)


def lacking(log: Log) -> list[str]:
    """Return the terms of the observation whose state a log lacks."""
    parts = log.observer(log.plan, log.memory(log.plan)).parts
    return [part.name for part in parts if part.term.name != "last_action" and log.term(part) is None]


@dataclass(frozen=True)
class Rival:
    """A loop beside some logs.

    Attributes:
        switches: its mistakes; () for the loop of the files.
        plan: the loop.
        physics: whether it is one of physics, such as a delay.
        left: (n, J) what it leaves of the output; NaN where it says nothing.
        price: −log p of its gains, relative to the stated ones [nat].
        since: when it begins in each log [s]; () from the first tick on.
    """

    switches: tuple[Switch, ...]
    plan: Plan
    physics: bool
    left: FloatArray
    price: float
    since: tuple[float, ...] = ()

    @property
    def mistakes(self) -> tuple[LoopMistake, ...]:
        """Its mistakes, in words; the keys of each have those before it. No keys state one that begins later."""
        if not self.since:
            return tuple(one.mistake for one in self.switches)
        when = f" from t = {min(self.since):.3g} s on"
        return tuple(replace(one.mistake, words=one.words + when, keys="") for one in self.switches)

    @property
    def rms(self) -> float:
        """What it leaves, over all joints; infinite where it says nothing."""
        return float(np.sqrt(np.nanmean(self.left**2))) if np.isfinite(self.left).any() else np.inf

    def score(self, ticks: float, step: float) -> float:
        """Return ℓ for so many independent ticks, and the rounding of the log."""
        return float(-0.5 * ticks * log_squares(self.left, step).sum() - self.price)

    @property
    def independent(self) -> float:
        """Number of independent ticks, from the correlation of neighbouring residuals."""
        one, other = self.left[:-1].ravel(), self.left[1:].ravel()
        both = np.isfinite(one) & np.isfinite(other)
        power = max(float(np.sum(one[both] ** 2)), 1e-300)
        rho = float(np.clip(np.sum(one[both] * other[both]) / power, 0.0, 0.99))
        return max(len(self.left) * (1.0 - rho) / (1.0 + rho), 1.0)


class Replay:
    """The logs of a machine, on whose state loops run."""

    def __init__(self, logs: Sequence[Log]) -> None:
        """Take logs that lack no term of the observation, and that have an output of the same kind."""
        self.logs = logs
        outputs = [Output.of(log) for log in logs]
        assert all(outputs)
        self.outputs = [one for one in outputs if one is not None]
        self.step = max(rounding(one.values) for one in self.outputs)
        if self.name == "tau":
            self.step = float(np.hypot(self.step, MOTOR * self.size))

    @property
    def name(self) -> str:
        """The channel of the output."""
        return self.outputs[0].name

    @property
    def size(self) -> float:
        """Rms of the output; of targets, about the default pose."""
        plan = self.logs[0].plan
        pose = plan.pose[np.argsort(plan.joints.qpos)] if self.name == "target" else 0.0
        values = np.concatenate([one.values for one in self.outputs])
        return float(np.sqrt(np.mean((values - pose) ** 2)))

    def begun(self, files: Rival) -> list[int]:
        """Return the tick of each log up to which the loop of the files explains the output; 0 for too few ticks."""
        power = np.mean(np.nan_to_num(files.left) ** 2, axis=1)
        ends, found = np.cumsum([0, *(len(log) for log in self.logs)]), []
        for first, last in pairwise(ends.tolist()):
            mean = np.cumsum(power[first:last]) / np.arange(1, last - first + 1)
            wrong = np.flatnonzero(mean > (EXPLAINED * self.size) ** 2)
            tick = int(wrong[0]) if wrong.size else 0
            found.append(tick if tick >= FEWEST else 0)
        return found

    def rival(
        self,
        plan: Plan,
        switches: tuple[Switch, ...] = (),
        physics: bool = False,
        begun: Sequence[int] = (),
    ) -> Rival:
        """Return a loop beside the logs; ``begun`` has the tick of each log at which it begins."""
        ticks = begun or [0] * len(self.logs)
        each = [
            self._left(log, output, plan, tick)
            for log, output, tick in zip(self.logs, self.outputs, ticks, strict=True)
        ]
        left, price = np.concatenate([left for left, _ in each]), sum(price for _, price in each)
        since = tuple(
            float(log.trace.times[tick]) for log, tick in zip(self.logs, ticks, strict=True) if tick
        )
        return Rival(switches, plan, physics, left, price, since)

    def _left(self, log: Log, output: Output, plan: Plan, begun: int) -> tuple[FloatArray, float]:
        made = actions(log, plan, begun)
        order = np.argsort(plan.joints.qpos)
        if output.name == "action":
            left = output.values - made
            if output.target is None:
                return left, 0.0
            target = plan.law.targets(log.limited(output.values), plan.pose)[:, order]
            return np.concatenate([left, output.target - target], axis=1), 0.0
        target = plan.law.targets(log.limited(made), plan.pose)
        if output.name == "target":
            return output.values - target[:, order], 0.0
        target = reached(log.robot.model, plan, target)[:, order]
        names = [plan.joints.names[k] for k in order]
        position, speed = log.joints("q", names), log.joints("dq", names)
        assert position is not None
        assert speed is not None
        motors = Motors(position, speed, output.values, stated_gains(log.robot.model, plan)[order])
        best = motors.best(target, self.step, (EXPLAINED * self.size) ** 2)
        return best.left, best.price


def replayed(logs: Sequence[Log]) -> Replayed | None:
    """Return what logs say of the loop; None where they have too little for it.

    A log counts if its rows are control ticks from the reset at t = 0 on, and if it has an output and the state behind
    every term. Of logs with different outputs only those like the first count.
    """
    robot, kinds = logs[0].robot, [_kind(log) for log in logs]
    first = next(filter(None, kinds), None)
    usable = [log for log, kind in zip(logs, kinds, strict=True) if kind is not None and kind == first]
    usable = usable[:: max(1, -(-len(usable) // LOGS))]
    if not usable or robot.policy is None or not robot.parts:
        return None
    replay = Replay(usable)
    files = replay.rival(robot.plan)
    late = [replay.rival(plan, physics=True) for plan in delayed(robot)]
    found = _ranked(replay, [files, *late], [replay.rival(one.plan, (one,)) for one in switches(robot)])
    begun = replay.begun(files)
    if found[0][0].rms > EXPLAINED * replay.size and any(begun):
        later = [replay.rival(one.plan, (one,), begun=begun) for one in switches(robot)]
        other = _ranked(replay, [files, *late], later)
        found = other if other[0][0].rms <= EXPLAINED * replay.size else found
    if found[0][0].switches and found[0][1] >= SURE:
        found = _with_second(replay, robot, found)
    best, sure = found[0]
    share = best.rms / max(replay.size, 1e-12)
    return Replayed(
        mistakes=best.mistakes,
        probability=sure,
        rivals=tuple((one.mistakes, p) for one, p in found[1:4]),
        share=share,
        files=files.rms / max(replay.size, 1e-12),
        output=replay.name,
        explained=share <= EXPLAINED,
        channels=frozenset().union(*(log.used for log in usable)),
    )


def _kind(log: Log) -> tuple[str, bool] | None:
    """Return what a log can be compared by; None where it cannot show its loop."""
    begins = bool(len(log.trace)) and abs(float(log.trace.times[0])) < 0.5 * log.plan.step
    if not begins or not log.is_by_ticks or lacking(log) or (output := Output.of(log)) is None:
        return None
    return output.name, output.target is not None


def _with_second(replay: Replay, robot: Robot, found: list[tuple[Rival, float]]) -> list[tuple[Rival, float]]:
    """Return loops with a second mistake, if one of them is surely better than the best with one.

    Then the first mistake may also be that of the next loops, in other quantities.
    """
    best = found[0][0]
    others = {one.switches[0].quantity: one for one, _ in reversed(found) if one.switches}
    del others[best.switches[0].quantity]
    next_best = sorted(others.values(), key=lambda one: [each for each, _ in found].index(one))
    more: list[Rival] = []
    for number, first in enumerate([best, *next_best[: FIRST - 1]]):
        if number and not _is_better(_ranked(replay, [best], more), best):
            break
        more += [replay.rival(one.plan, (*first.switches, one)) for one in switches(robot, first.plan)]
    both = _ranked(replay, [best], more)
    return both if _is_better(both, best) else found


def _is_better(ranked: Sequence[tuple[Rival, float]], best: Rival) -> bool:
    return ranked[0][0] is not best and ranked[0][1] >= SURE


def _ranked(replay: Replay, before: Sequence[Rival], rivals: Sequence[Rival]) -> list[tuple[Rival, float]]:
    """Return loops with their probabilities, of which those before are as likely as all others together."""
    every = [*before]
    for one in rivals:  # two mistakes may be the same here: legs that are mirrored exactly
        if not any(np.allclose(one.left, other.left, atol=1e-9, equal_nan=True) for other in every):
            every.append(one)
    ticks = min(every, key=lambda one: one.rms).independent
    prior = [0.5 / len(before)] * len(before) + [0.5 / max(len(rivals), 1)] * (len(every) - len(before))
    scores = np.array([one.score(ticks, replay.step) for one in every]) + np.log(prior)
    chance = np.exp(scores - scores.max())
    chance /= chance.sum()
    return [(every[k], float(chance[k])) for k in np.argsort(-chance, kind="stable")]


def actions(log: Log, plan: Plan, begun: int = 0) -> FloatArray:
    """Return (n, k) what the policy does in a loop on the state of a log; before a tick in that of the files."""
    policy, memory = log.robot.policy, log.memory(plan)
    assert policy is not None
    before, after, made = log.observer(log.plan, memory), log.observer(plan, memory), []
    policy.reset()
    for tick in range(len(log)):
        seen = [observer.read(tick) for observer in (before, after)] if begun else [after.read(tick)]
        action = policy(seen[0] if tick < begun else seen[-1]).astype(np.float64)
        action = np.nan_to_num(action, nan=FAR, posinf=FAR, neginf=-FAR)
        memory.last_action[:] = log.limited(action)
        made.append(action)
    return np.array(made)
