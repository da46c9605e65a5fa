"""`gap` and `certify` on recordings: what a machine already did, held against its simulator."""

import re
from concurrent.futures import ThreadPoolExecutor
from functools import cache

import numpy as np
import pytest

import s2r_spec as s2r
from s2r_spec.certify.bound.certificate import Label
from s2r_spec.certify.gap import gap
from s2r_spec.certify.real_machine import certify
from s2r_spec.errors import UsageError
from s2r_spec.runs.journal import Journal
from s2r_spec.runs.replay import replay
from s2r_spec.runs.task import open_backend
from tests.certify.logs import record_from
from tests.errors import naming, states

pytestmark = pytest.mark.usefixtures("toy")

SPEC = """\
signal vx {m/s}
param  vd {m/s} in [-0.2, 0.3]
require walking: always[0.5 s, 1.5 s] (abs(vx - vd) <= LIMIT {m/s})
certify walking: delta = 1e-3, epsilon = 0.05, B = 0.5, R = 0.02, kernel = rbf(0.2 {m/s}), fall = -0.5
"""
# Unequal coverage: nothing was recorded above 0.1 m/s.
HALF = [vd for vd in np.linspace(-0.2, 0.1, 13).tolist() for _ in range(8)]
WHOLE = [vd for vd in np.linspace(-0.2, 0.3, 21).tolist() for _ in range(8)]


def spec(limit=0.15):
    return s2r.parse_spec(SPEC.replace("LIMIT", str(limit)), "spec.stl")


def run(call, tmp_path, simulated, real, limit=0.15, run="run", **words):
    open_backend.cache_clear()  # a worker opens a backend once; here folders come and go
    return call(spec(limit), simulated, real, tmp_path / run, executor=lambda: ThreadPoolExecutor(1), **words)


@cache
def expected(name, rollouts=200):
    """Return (11,) mean ρ over the test space, by brute force."""
    machine, law = s2r.load_backend(name), spec()
    return np.array(
        [
            np.mean(
                [
                    law.robustness(machine.rollout({"vd": v}, 10_000 + i), params={"vd": v})["walking"]
                    for i in range(rollouts)
                ]
            )
            for v in np.linspace(-0.2, 0.3, 11)
        ]
    )


def test_the_gap_to_a_log_contains_the_true_one_and_counts_every_recording_once(tmp_path):
    log = record_from("toy:drag", WHOLE, tmp_path / "log")
    result = run(gap, tmp_path, "toy", log)
    delta = expected("toy:drag") - expected("toy")
    noise = 4 * 0.01 * np.sqrt(2 / 200)
    assert result.lower - noise <= delta.min() <= result.upper + noise
    assert result.low - noise <= delta.min() <= delta.max() <= result.high + noise
    assert result.worst.mean < -0.01
    assert (result.certificate.rollouts, result.certificate.points) == (len(WHOLE), 21)
    real, sim = (Journal.read(tmp_path / "run" / side).records() for side in ("real", "sim"))
    assert sorted(one.params["vd"] for one in real) == sorted(WHOLE)
    assert len(sim) == 2 * len(real)
    assert len({one.seed for one in sim}) == len(sim)
    assert any("fixed beforehand" in text for text in result.assumptions)
    assert any("as it was when it was recorded" in text for text in result.assumptions)
    assert result.certificate.settings["R"] == pytest.approx(0.02 * np.sqrt(1.5))


def test_what_the_recorded_tests_leave_open_is_said(tmp_path):
    log = record_from("toy:drag", HALF, tmp_path / "log")
    result = run(gap, tmp_path, "toy", log)
    assert result.certificate.label is Label.BUDGET
    assert any(states(text, "ε = 0.05", "vd = 0.3 m/s", "1 lengthscales") for text in result.assumptions)
    delta = expected("toy:drag") - expected("toy")
    assert result.lower < delta.min()  # where nothing was recorded, too


def test_a_log_can_be_promised_about_and_resumed(tmp_path):
    log = record_from("toy:drag", WHOLE, tmp_path / "log")
    result = run(certify, tmp_path, "toy", log)
    truth = expected("toy:drag").min()
    assert result.verdict.value == "holds"
    assert 0 <= result.composition.lower <= truth <= result.composition.upper
    before = (tmp_path / "run" / "gap" / "sim" / "journal.jsonl").read_bytes()
    again = run(certify, tmp_path, "toy", log, resume=True)
    assert again.composition == result.composition
    assert (tmp_path / "run" / "gap" / "sim" / "journal.jsonl").read_bytes() == before


def test_an_undecided_promise_names_the_next_test_to_record(tmp_path):
    log = record_from("toy:drag", HALF, tmp_path / "log")
    result = run(certify, tmp_path, "toy", log)
    assert result.verdict.value == "unknown"
    assert "vd = 0.3" in result.reason


def test_both_sides_may_be_recordings(tmp_path):
    real = record_from("toy:drag", WHOLE, tmp_path / "real")
    # 16 simulated recordings at some tests, 12 at others, and some tests that the machine never did.
    tests = [vd for i, vd in enumerate(np.linspace(-0.2, 0.3, 41).tolist()) for _ in range(12 + i % 8)]
    sim = record_from("toy", tests, tmp_path / "sim", seed=5000)
    result = run(gap, tmp_path, sim, real)
    delta = expected("toy:drag") - expected("toy")
    noise = 4 * 0.01 * np.sqrt(2 / 200)
    assert result.lower - noise <= delta.min() <= result.upper + noise
    assert result.certificate.rollouts == len(WHOLE)
    assert result.certificate.settings["R"] == pytest.approx(0.02 * np.sqrt(2))
    assert any(re.search(r"\d+ (of \d+ )?simulated recordings", text) for text in result.assumptions)
    assert any(states(text, "mean", "one or two") for text in result.assumptions)
    for side in ("sim", "real"):
        assert replay(f"{tmp_path / 'run' / side}#3.1").same
    assert replay(f"{tmp_path / 'run' / 'sim'}#0.1").same  # the second simulated one of the first pair
    assert run(gap, tmp_path, sim, real, resume=True).certificate == result.certificate


def test_a_parameter_that_only_the_log_declares_is_said(tmp_path):
    log = record_from("toy:drag", HALF, tmp_path / "log", load=2.0)
    result = run(gap, tmp_path, "toy", log)
    assert any(states(text, "load = 2 kg", "spec.stl", "toy", "0 kg") for text in result.assumptions)


def test_what_cannot_be_paired_gets_a_sentence(tmp_path):
    log = record_from("toy:drag", [-0.1, 0.1], tmp_path / "log")
    other = record_from("toy", [0.0, 0.2], tmp_path / "other")
    outside = record_from("toy", [0.4], tmp_path / "outside")
    with pytest.raises(UsageError, match=naming("budget", "log:")):
        run(gap, tmp_path, "toy", log, budget=40)
    with pytest.raises(UsageError, match=naming("stop", "'decided'", "log:")):
        run(certify, tmp_path, "toy", log, stop="decided")
    with pytest.raises(UsageError, match=naming(log, "toy")):
        run(gap, tmp_path, log, "toy")
    with pytest.raises(UsageError, match=naming(log, "same")):
        run(gap, tmp_path, log, log)
    with pytest.raises(UsageError, match=naming("vd = -0.1; vd = 0.1")):
        run(gap, tmp_path, other, log)
    with pytest.raises(UsageError, match=naming("1 recordings")):
        run(certify, tmp_path, "toy", outside)
    assert not (tmp_path / "run").exists()  # nothing was run for them
