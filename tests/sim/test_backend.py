"""The contract of a backend: what it declares, what it refuses, and that a rollout is a pure function."""

import pickle
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np
import pytest

from s2r_sim import SimBackend
from s2r_sim.controller.gains import Gains
from s2r_sim.plant.noise import Noise
from s2r_sim.rollout import simulator
from s2r_sim.settings import Settings
from s2r_spec.backend import Backend, HasDuration, load_backend
from s2r_spec.errors import UsageError
from tests.errors import naming

SHORT = SimBackend(duration=0.3, settings=Settings(warm_up=0.2))


@pytest.fixture(scope="module")
def plain():
    """The rollout that others are held against."""
    return SHORT.rollout({"vd": 0.3}, seed=7)


@pytest.fixture(scope="module")
def recorded():
    return SHORT.rollout({"vd": 0.2}, seed=3)


def same(a, b):
    return (
        a.times.tobytes() == b.times.tobytes()
        and a.channels.keys() == b.channels.keys()
        and all(a[name].tobytes() == b[name].tobytes() for name in a.channels)
    )


def test_it_is_found_by_name_and_keeps_the_protocol():
    backend = load_backend("sim")
    assert isinstance(backend, Backend)
    assert isinstance(backend, HasDuration)
    assert backend.duration == 1.5
    assert backend.deterministic
    assert backend.cost > 0.0


def test_importing_it_imports_no_physics():
    engines = "('mujoco', 'numba', 'pinocchio', 'piqp', 'scipy')"
    script = f"import sys, s2r_sim; print([m for m in {engines} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_every_declared_channel_is_in_the_trace_with_its_unit(recorded):
    trace = recorded
    assert list(trace.channels) == [channel.name for channel in SHORT.channels]
    for channel in SHORT.channels:
        shape = (len(trace),) if channel.width == 1 else (len(trace), channel.width)
        assert trace[channel.name].shape == shape
        assert trace.units[channel.name] == channel.unit
        assert np.isfinite(trace[channel.name]).all()


def test_times_are_the_control_ticks_from_zero_to_the_duration(recorded):
    trace = recorded
    assert trace.times.tolist() == [k / 500 for k in range(151)]


def test_the_command_steps_at_time_zero_out_of_trotting_in_place(plain):
    assert (plain["vx_cmd"] == 0.3).all()
    assert abs(plain["vx"][0]) < 0.03


def test_meta_says_what_made_the_trace(recorded):
    trace = recorded
    assert trace.meta["params"]["vd"] == 0.2
    assert trace.meta["seed"] == 3
    assert trace.meta["model_hash"] == SHORT.model_hash
    assert trace.meta["qp_failures"] == 0


def test_a_duration_between_two_ticks_is_rounded_up():
    assert SHORT.with_duration(0.1011).duration == pytest.approx(0.102)
    assert SHORT.with_duration(1.5).duration == 1.5


def test_a_rollout_depends_on_its_arguments_only(plain):
    SHORT.rollout({"vd": -0.5}, seed=1)
    SHORT.with_duration(1.0).rollout({"push": 30.0, "push_time": 0.1}, seed=2)
    assert same(plain, SHORT.rollout({"vd": 0.3}, seed=7))


def test_a_fresh_simulator_gives_the_same_bits(plain):
    simulator.cache_clear()
    assert same(plain, pickle.loads(pickle.dumps(SHORT)).rollout({"vd": 0.3}, seed=7))


def test_a_longer_rollout_begins_with_the_shorter_one(plain):
    short = SHORT.with_duration(0.1).rollout({"vd": 0.3}, seed=7)
    assert plain["vx"][: len(short)].tobytes() == short["vx"].tobytes()


def test_seeds_differ_in_gait_phase_and_noise(plain):
    a, b = plain, SHORT.rollout({"vd": 0.3}, seed=1)
    assert not same(a, b)
    assert (a["stance"] != b["stance"]).any()


def test_without_noise_every_seed_is_the_same():
    quiet = SimBackend(duration=0.1, noise=Noise.off())
    assert same(quiet.rollout({"vd": 0.3}, seed=1), quiet.rollout({"vd": 0.3}, seed=2))


@pytest.mark.parametrize("bad", [{"vd": 0.51}, {"vd": float("nan")}])
def test_a_value_out_of_range_is_refused_with_the_range(bad):
    with pytest.raises(UsageError, match=naming("vd = ", "[-0.5, 0.5] m/s")):
        SHORT.rollout(bad, seed=0)


def test_an_unknown_parameter_is_refused_with_the_known_ones():
    known = "friction, payload, push, push_time, push_towards, slope, vd, vy, wz"
    with pytest.raises(UsageError, match=naming("'vdd'", "did you mean 'vd'", known)):
        SHORT.rollout({"vdd": 0.1}, seed=0)


def test_the_model_hash_follows_what_decides_a_trace():
    other_gains = SimBackend(settings=Settings(gains=Gains(raibert=0.11)))
    hashes = {SimBackend().model_hash, SimBackend(noise=Noise.off()).model_hash, other_gains.model_hash}
    assert len(hashes) == 3
    assert SimBackend().model_hash == SimBackend(duration=3.0).model_hash


def test_parameters_of_the_world_at_their_defaults_change_no_bit(plain):
    assert same(plain, SHORT.rollout({p.name: p.default for p in SHORT.parameters} | {"vd": 0.3}, seed=7))


@pytest.mark.parametrize(("name", "value"), [("slope", 3.0), ("friction", 0.3), ("payload", 2.0)])
def test_a_test_in_another_world_is_a_pure_function_too(plain, name, value):
    first = SHORT.rollout({"vd": 0.3, name: value}, seed=7)
    assert not same(first, plain)
    simulator.cache_clear()
    assert same(first, SHORT.rollout({"vd": 0.3, name: value}, seed=7))


def test_a_parameter_and_an_effect_of_the_same_world_add_up():
    tilted = SHORT.with_effects({"slope": {"angle": 1.0}}).rollout({"slope": 2.0}, seed=7)
    assert same(tilted, SHORT.rollout({"slope": 3.0}, seed=7))


def test_in_other_processes_and_another_order_the_bits_are_the_same(plain, recorded):
    tests = [({"vd": 0.3}, 7), ({"vd": -0.2, "payload": 1.0}, 2), ({"vd": 0.2}, 3)]
    here = [plain, SHORT.rollout(*tests[1]), recorded]
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        jobs = {k: pool.submit(SHORT.rollout, *tests[k]) for k in (1, 2, 0)}
        assert all(same(here[k], job.result()) for k, job in jobs.items())
