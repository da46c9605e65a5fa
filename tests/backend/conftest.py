"""A newcomer's folder: a file with a simulator and the file of its constants."""

import sys

import pytest

from s2r_spec.backend import files
from tests.cli.conftest import SPEC, CommandLine

CART = """\
import numpy as np

from constants import GAIN
from s2r_spec import Trace
from s2r_spec.backend import Channel, Effect, EffectParameter, Parameter

TIMES = np.arange(151) / 100


def simulate(params, seed, rate=GAIN, factor=1.0):
    noise = 0.001 * np.random.default_rng(seed).normal()
    vx = factor * params["vd"] * (1 - np.exp(-rate * TIMES)) + noise
    return Trace(TIMES, {"vx": vx}, {"vx": "m/s"})


def glide(params, seed):
    return simulate(params, seed)


class Cart:
    cost = 1e-3

    def __init__(self, options=""):
        self.factor = float(options.partition("=")[2] or 1.0)

    def rollout(self, params, seed):
        return simulate(params, seed, factor=self.factor)


def make(options=""):
    return Cart(options)


def called(function):
    return lambda params, seed: function(params, seed)


cart = Cart("factor=0.9")
local = called(glide)

DRAG = EffectParameter("rate", "1/s", 0.0, 5.0, 0.0, "half-normal, 1 1/s")
MOTOR = EffectParameter("factor", "", 0.5, 1.2, 1.0, "normal around 1, standard deviation 0.1")


class Worn:
    effects = (
        Effect("drag", "friction", "The cart is slower to start.", (DRAG,)),
        Effect("motor", "actuation", "The motor makes this fraction of its speed.", (MOTOR,)),
    )
    cost = 1e-3

    def rollout(self, params, seed, effects):
        return simulate(params, seed, GAIN - effects["drag"]["rate"], effects["motor"]["factor"])


class Whole:
    name, deterministic, duration, cost, model_hash = "whole", True, 1.5, 1e-3, "whole-1"
    channels = (Channel("vx", "m/s", "speed"),)
    parameters = (Parameter("vd", "m/s", -0.5, 0.5, 0.0, "commanded speed"),)

    def __init__(self, options=""):
        self.options = options

    def rollout(self, params, seed):
        return simulate(params, seed)


class Partial(Whole):
    @property
    def duration(self):
        raise AttributeError


class Machine:
    exclusive = True

    def rollout(self, params, seed):
        raise AssertionError


class Seedless:
    def rollout(self, params):
        raise AssertionError
"""


@pytest.fixture(autouse=True)
def nothing_loaded(monkeypatch):
    """Forget the files of other tests, and those of this one at its end."""
    monkeypatch.setattr(files, "_PLACES", {})
    monkeypatch.setattr(files, "_DIGESTS", {})
    monkeypatch.setattr(files, "_CONTENTS", {})
    monkeypatch.setattr(sys, "path", [*sys.path])
    before = {*sys.modules}
    yield
    for name in {*sys.modules} - before:
        file = getattr(sys.modules[name], "__file__", None) or ""
        if "/pytest-of-" in file:
            del sys.modules[name]


@pytest.fixture
def s2r(tmp_path, toy, monkeypatch):
    """The command line in a folder with ``cart.py`` and ``spec.stl``, in which this process is, too."""
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cart.py").write_text(CART)
    (tmp_path / "constants.py").write_text("GAIN = 10.0\n")
    (tmp_path / "spec.stl").write_text(SPEC.replace("LIMIT", "0.1"))
    (tmp_path / "file.glide").write_text("drag")
    return CommandLine(tmp_path)
