"""Excitation protocols: how a backend offers them, how one is run, checked, listed and written for a robot to play."""

import numpy as np
import pytest
from s2r_toy import Toy

import s2r_spec as s2r
from benchmarks.blind.a1.protocols import drill
from s2r_sim.protocols.references import MOTIONS, reference
from s2r_spec.backend import Parameter
from s2r_spec.conformance import check_conformance
from s2r_spec.errors import BackendError, UsageError
from s2r_spec.protocols import HasProtocols, Protocol, named, run_protocol, write_playable
from s2r_spec.runs.task import Task, run_task
from s2r_spec.trace import Trace
from tests.errors import naming, states

TIMES = np.arange(11) / 10
CHIRP = Protocol(
    "chirp",
    "The cart follows a chirp.",
    "space",
    1.0,
    0.01,
    "it hits the end",
    (Parameter("rate", "Hz", 0.5, 2.0, 1.0, "highest frequency"),),
)


class Chirped(Toy):
    """A toy with one protocol."""

    offered = (CHIRP,)

    def protocols(self):
        return self.offered

    def run(self, protocol, params, seed):
        values = named(self.offered, protocol, self.name).values(params)
        meta = {"protocol": protocol, "params": values, "seed": seed}
        return Trace(TIMES, {"y": np.sin(values["rate"] * TIMES) + seed}, {"y": "m"}, meta)

    def playable(self, protocol, params):
        rate = named(self.offered, protocol, self.name).values(params)["rate"]
        q = np.stack([np.sin(rate * TIMES), np.cos(rate * TIMES)], axis=1)
        gains = {"kp": np.full(11, 5.0), "kd": np.full(11, 0.5)}
        return Trace(TIMES, {"q": q, "dq": rate * q[:, ::-1], **gains}, {"q": "rad", "dq": "rad/s"})


def broken(backend):
    return [sentence for check in check_conformance(backend) for sentence in check.violations]


@pytest.mark.parametrize("name", sorted(MOTIONS))
@pytest.mark.parametrize(("amplitude", "gain"), [(1.0, 1.0), (0.4, 0.7)])
def test_simulator_and_blind_generator_play_the_same_references(name, amplitude, gain):
    """They are two programs from the same words."""
    ours, theirs = reference(name, amplitude, gain), drill(name, amplitude, gain)
    for one, other in ((ours.q, theirs.angles), (ours.kp, theirs.stiffness), (ours.kd, theirs.damping)):
        assert one.shape == other.shape
        assert np.abs(one - other).max() <= 1e-12
    assert (ours.height, ours.held) == (theirs.height, theirs.rig)


@pytest.mark.parametrize("place", ["lab", "grass"])
def test_a_twin_runs_them_and_does_not_name_its_effects(place):
    twin = s2r.load_backend(f"twin:{place}")
    assert isinstance(twin, HasProtocols)
    trace = twin.run("air_low", {"amplitude": 0.5}, 3)
    nominal = s2r.load_backend("sim").run("air_low", {"amplitude": 0.5}, 3)
    assert (trace.meta["protocol"], trace.meta["params"]) == ("air_low", {"amplitude": 0.5, "gain": 1.0})
    assert "effects" not in trace.meta
    assert trace.meta.keys() == nominal.meta.keys()
    assert place == "grass" or not np.array_equal(trace["q"], nominal["q"])


def test_a_fall_in_a_protocol_ends_its_trace_and_is_no_error():
    trace = s2r.load_backend("sim").run("squeeze", {"gain": 0.5}, 1)
    assert trace.failure == "fall"
    assert trace.duration < 1.9
    assert trace["fallen"][-1] == 1


def test_a_backend_with_protocols_is_checked():
    assert broken(Chirped()) == []
    assert len([c for c in check_conformance(Chirped()) if "protocol" in c.requirement]) == 5


@pytest.mark.parametrize(
    ("changes", "facts"),
    [
        ({"offered": (CHIRP, CHIRP)}, ["chirp", "2 times"]),
        ({"run": lambda self, name, params, seed: Trace(TIMES, {"y": 0 * TIMES})}, ["chirp", "meta"]),
        (
            {"run": lambda self, *given: Trace(TIMES[:5], {"y": TIMES[:5]}, {}, {"protocol": "chirp"})},
            ["chirp", "0.4 s", "1 s"],
        ),
        (
            {
                "run": lambda self, name, params, seed: Trace(
                    TIMES, {"y": np.random.default_rng().normal(size=11)}, {}, {"protocol": "chirp"}
                )
            },
            ["chirp", "differ"],
        ),
        ({"playable": lambda self, name, params: Trace(TIMES, {"q": TIMES})}, ["chirp", "dq, kp, kd"]),
    ],
)
def test_protocols_that_break_their_promises_are_named(changes, facts):
    sentences = broken(type("Odd", (Chirped,), changes)())
    assert any(states(sentence, *facts) for sentence in sentences), sentences


@pytest.mark.parametrize(
    ("name", "params", "facts"),
    [
        ("chrip", {}, ["'chrip'", "chirp"]),
        ("chirp", {"rate": 3.0}, ["rate", "3 Hz"]),
        ("chirp", {"speed": 1.0}, ["'speed'", "rate"]),
    ],
)
def test_what_a_backend_does_not_offer_is_refused(name, params, facts):
    with pytest.raises(UsageError, match=naming(*facts)):
        run_protocol(Chirped(), name, params, 0)
    with pytest.raises(UsageError, match=naming("protocols")):
        run_protocol(Toy(), "chirp", {}, 0)


def test_a_worker_runs_a_protocol_as_a_task():
    trace, _ = run_task(Task(0, 0, "sim", {"amplitude": 0.5}, 1, protocol="air_coast"))
    assert trace.meta["protocol"] == "air_coast"
    with pytest.raises(BackendError, match=naming("'air_cost'", "air_coast")):
        run_task(Task(0, 0, "sim", {}, 1, protocol="air_cost"))


def test_a_file_that_a_robot_can_play(tmp_path):
    path = tmp_path / "chirp.csv"
    words = write_playable(Chirped(), "chirp", {"rate": 2.0}, path)
    header, *rows = path.read_text().splitlines()
    assert header.split(",") == [
        *("t [s]", "q_0 [rad]", "q_1 [rad]", "dq_0 [rad/s]", "dq_1 [rad/s]", "kp", "kd")
    ]
    assert len(rows) == 11
    assert s2r.read_trace(path)["q_0"][1] == pytest.approx(np.sin(0.2))
    assert states(words, "chirp.csv", "100 ms", "hits the end")
    for wrong, facts in (("a.npz", [".csv"]), ("a.csv", ["'speed'"])):
        with pytest.raises(UsageError, match=naming(*facts)):
            write_playable(Chirped(), "chirp", {} if facts[0] == ".csv" else {"speed": 1.0}, tmp_path / wrong)
    with pytest.raises(UsageError, match=naming("playable")):
        write_playable(s2r.load_backend("sim"), "squat", {}, path)
