"""A machine whose test shows the sum of two effects; one protocol tells them apart, and another shows two more.

``swing:a=2,c=-1`` has these sizes of its effects [N].
"""

from dataclasses import dataclass, replace

import numpy as np

from s2r_spec.backend import Channel, Effect, EffectParameter, Parameter
from s2r_spec.diagnose.simulator.experiments import Experiment
from s2r_spec.protocols import PROTOCOL, Protocol
from s2r_spec.trace import Trace

EFFECTS = tuple(
    Effect(name, family, "", (EffectParameter("size", "N", -4.0, 4.0, 0.0, "normal, 1 N"),))
    for name, family in (("a", "left"), ("b", "left"), ("c", "right"), ("d", "right"))
)
TEST, SPLIT, SHOW = Experiment.test({"v": 0.5}), Experiment("split"), Experiment("show")
TIMES = np.linspace(0.0, 1.0, 201)
SHAPES = {"a": TIMES * (1 - TIMES), "b": np.sin(7 * TIMES) ** 2, "c": np.cos(5 * TIMES), "d": TIMES**2}


def swing(options: str = ""):
    """Return the machine with the sizes of its options."""
    words = (word.split("=") for word in options.split(",") if word)
    return Toy(tuple((name, float(size)) for name, size in words))


@dataclass(frozen=True)
class Toy:
    added: tuple[tuple[str, float], ...] = ()
    name: str = "toy"
    model_hash: str = "1"
    duration: float = 1.0
    deterministic: bool = True
    cost: float = 1e-3
    channels: tuple[Channel, ...] = (Channel("x", "N", "reading"),)
    parameters: tuple[Parameter, ...] = (Parameter("v", "", 0.0, 1.0, 0.5, "speed"),)

    def effects(self):
        return EFFECTS

    def with_effects(self, values):
        return replace(self, added=tuple((name, of["size"]) for name, of in values.items()))

    def protocols(self):
        return tuple(Protocol(name, "", "space", 1.0, 1.0) for name in ("split", "show"))

    def rollout(self, params, seed):
        own = dict(self.added)
        return self._trace((own.get("a", 0.0) + own.get("b", 0.0)) * SHAPES["a"], seed)

    def run(self, protocol, params, seed):
        own = dict.fromkeys("abcd", 0.0) | dict(self.added)
        shown = "ab" if protocol == "split" else "cd"
        trace = self._trace(sum(own[name] * SHAPES[name] for name in shown), seed)
        return replace(trace, meta={PROTOCOL: protocol})

    def play(self, inputs, params, seed):
        """Return the test: its commands are the same in every one."""
        return self.rollout({}, seed)

    def playable(self, protocol, params):
        """Return references of one joint."""
        q = SHAPES["b" if protocol == "split" else "c"]
        gains = np.full(TIMES.size, 20.0)
        channels = {"q": q[:, None], "dq": np.gradient(q, TIMES)[:, None], "kp": gains, "kd": 0.1 * gains}
        return Trace(TIMES, channels, {"q": "rad", "dq": "rad/s", "kp": "N*m/rad", "kd": "N*m*s/rad"}, {})

    def _trace(self, values, seed):
        noise = 0.05 * np.random.default_rng(seed).normal(size=TIMES.size)
        return Trace(TIMES, {"x": values + noise}, {"x": "N"}, {})
