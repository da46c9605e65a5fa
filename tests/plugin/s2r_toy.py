"""A backend as another package would offer it: a point that glides to its commanded speed, with noise.

What it does besides is in its name, so that workers see it too: ``toy:raise``
raises at every rollout, ``toy:die`` kills the process that runs it at speeds
above 0.29 m/s, ``toy:fall`` falls there, ``toy:hang`` computes there without end,
``toy:sleep`` sleeps there, ``toy:slow`` takes 20 ms, ``toy:dozes`` sleeps 0.3 s,
``toy:drag`` reaches only nine tenths of its speed; ``toy:counts``,
``toy:recurrent``, ``toy:first`` and ``toy:cached`` keep something between
rollouts, and ``toy:unseeded`` ignores its seed; ``toy:waits`` waits before the
tenth rollout of a process as long as there is the file that ``S2R_TOY_WAITS``
names; ``exit``, ``missing``, ``dict`` and ``nan`` break the contract.
"""

from __future__ import annotations

import ctypes
import os
import signal
import time
from itertools import count, repeat
from pathlib import Path

import numpy as np

from s2r_spec.backend import Channel, Parameter
from s2r_spec.errors import MissingPackageError
from s2r_spec.trace import Trace

RUN = count(1)
"""Rollouts of this process that could wait."""
COUNT = count()
KEPT: dict[str, float] = {}


class Toy:
    channels = (Channel("vx", "m/s", "speed"), Channel("extra", "", "not read by the spec"))
    parameters = (
        Parameter("vd", "m/s", -0.5, 0.5, 0.0, "commanded speed"),
        Parameter("load", "kg", 0.0, 5.0, 0.0, "payload"),
    )
    deterministic = True
    cost = 1e-4
    duration = 1.5

    def __init__(self, habit: str = "") -> None:
        self.habit = habit
        self.name = f"toy:{habit}" if habit else "toy"

    @property
    def model_hash(self) -> str:
        return os.environ.get("S2R_TOY_MODEL", "toy-1")

    def with_duration(self, seconds: float) -> Toy:
        longer = type(self)(self.habit)
        longer.duration = seconds
        return longer

    def rollout(self, params, seed) -> Trace:
        vd = params["vd"]
        if self.habit == "raise":
            raise ValueError(os.environ.get("S2R_TOY_SAYS", "the gyroscope is upside down"))
        if self.habit == "exit":
            raise SystemExit(0)
        if self.habit == "missing":
            raise MissingPackageError("toy", "gyroscope")
        if self.habit == "dict":
            return {"vx": vd}
        if self.habit == "slow":
            time.sleep(0.02)
        if self.habit == "dozes":
            time.sleep(0.3)
        if self.habit == "waits" and next(RUN) >= 10:
            while "S2R_TOY_WAITS" in os.environ and Path(os.environ["S2R_TOY_WAITS"]).exists():
                time.sleep(0.01)
        if self.habit == "die" and vd > 0.29:
            os.kill(os.getpid(), signal.SIGSEGV)
        if self.habit == "hang" and vd > 0.29:
            sum(repeat(0))  # and holds the interpreter's lock meanwhile
        if self.habit == "sleep" and vd > 0.29:
            ctypes.PyDLL(None).sleep(1000)  # holds it, too
        rng = np.random.default_rng(seed)
        times = np.arange(round(self.duration * 100) + 1) / 100
        bias = 0.01 * rng.normal() - 0.02 * abs(vd)
        meta = {"failure": "fell [/leg]"} if self.habit == "fall" and vd > 0.29 else {}
        reach = 0.9 if self.habit == "drag" else 1.0
        vx = reach * vd * (1 - np.exp(-times / 0.1)) + bias
        vx += self.kept(vd)
        if self.habit == "nan" and vd > 0.2:
            vx[70] = np.nan
        return Trace(times, {"vx": vx, "extra": 0 * vx}, {"vx": "m/s"}, meta)

    def kept(self, vd: float) -> float:
        """Return what earlier rollouts of this process change in the speed [m/s]."""
        match self.habit:
            case "counts":
                return 1e-9 * next(COUNT)
            case "recurrent":  # as the hidden state of a policy that nobody resets
                KEPT["state"] = 0.5 * KEPT.get("state", 0.0) + 1e-3 * vd
                return KEPT["state"]
            case "first":  # as a model that is built once, for the first test
                return 1e-3 * KEPT.setdefault("vd", vd)
            case "cached":
                return KEPT.setdefault("model", 1e-3)
            case "unseeded":
                return 1e-6 * np.random.default_rng().normal()
        return 0.0


class ShortToy(Toy):
    with_duration = None


class NotABackend:
    name = "broken"


def open_file(text: str) -> Toy:
    """Open a file ``NAME.glide``, whose content is a habit, as its ending says."""
    path, _, options = text.partition(":")
    toy = Toy(options or Path(path).read_text().strip())
    toy.name = text
    return toy
