"""Samples that look like the recording's doing are reported; real motion is not."""

import numpy as np
import pytest
from s2r_cart import SPEC, Cart, real

import s2r_spec as s2r
from s2r_spec.diagnose.quality.channels import by_channel
from s2r_spec.diagnose.quality.recordings import Recordings
from s2r_spec.diagnose.simulator.bench import Bench
from s2r_spec.report.advice import next_step
from s2r_spec.trace import Trace
from tests.errors import states

BENCH = Bench.of(s2r.parse_spec(SPEC), "tracking", Cart())


def changed(trace, name, at, value):
    values = trace[name].copy()
    values[at] = value
    return Trace(trace.times, dict(trace.channels) | {name: values}, trace.units)


def glitches(runs):
    """Return what is said of samples that one rollout has and most have not."""
    return [each for each in by_channel(Recordings(BENCH, runs)) if each.code in ("spike", "stopped")]


def many(effects, spoil=None, which=3):
    tests = [{"vd": 0.2 + 0.1 * k, "acc": 2.0} for k in range(8)]
    runs = [(test, real(test, i, effects)) for i, test in enumerate(tests)]
    if spoil is not None:
        runs[which] = (runs[which][0], spoil(runs[which][1]))
    return runs


def test_a_single_sample_far_off_is_told_with_its_rollout_its_time_and_its_size():
    def spike(trace):
        return changed(trace, "v_meas", 40, trace["v_meas"][40] + 30.0)

    [glitch] = [each.text for each in glitches(many({}, spike))]
    when = many({})[3][1].times[40]
    assert glitch.startswith("v_meas of real rollout 3 (vd = 0.5, acc = 2) is off by")
    assert f" {when:.4g} s" in glitch
    assert float(glitch.split("off by ")[1].split()[0]) == pytest.approx(30.0, rel=0.1)


def test_a_channel_that_stops_in_the_middle_is_told_with_when():
    def stuck(trace):
        return changed(trace, "v_meas", slice(8, 60), trace["v_meas"][8])

    runs = many({}, stuck)
    [glitch] = [each.text for each in glitches(runs)]
    times = runs[3][1].times
    assert f" from {times[8]:.4g} to {times[59]:.4g} s" in glitch


def test_a_step_noise_a_lost_channel_and_what_saturates_are_not():
    def step(trace):
        return changed(trace, "v_meas", slice(40, None), trace["v_meas"][40:] + 30.0)

    def noisy(trace):
        noise = np.random.default_rng(0).normal(size=len(trace))
        return changed(trace, "v_meas", slice(None), trace["v_meas"] + 1e-3 * noise)

    def saturated(trace):
        return changed(trace, "v_meas", slice(8, 60), 100.0)

    def lost(trace):
        return changed(trace, "v_meas", slice(40, 50), np.nan)

    for spoil in (None, step, noisy, saturated, lost):
        assert glitches(many({}, spoil)) == []


LENGTHS = (30, 300, 3000, 20_000)


def noisy_runs(samples, seed, step=0.0, spike=0.0):
    """Five rollouts that move, and one of measuring noise alone; ``step`` is that of the converter."""
    rng, times = np.random.default_rng(seed), np.linspace(0.0, 2.0, samples)
    runs = []
    for k in range(6):
        values = np.sin((k != 2) * 3.0 * times) + 0.02 * rng.normal(size=samples)
        values[samples // 2] += spike * (k == 2)
        values = np.round(values / step) * step if step else values
        runs.append(({"vd": 0.2 + 0.1 * k, "acc": 2.0}, Trace(times, {"v_meas": values}, {"v_meas": "m/s"})))
    return runs


@pytest.mark.parametrize("step", [0.0, 0.02, 0.1])
@pytest.mark.parametrize("samples", LENGTHS)
def test_the_largest_of_many_samples_of_noise_is_no_glitch(samples, step):
    """At the level of 5 % for a whole set of recordings, three of 12 sets with one would be much (p = 0.02)."""
    found = [by_channel(Recordings(BENCH, noisy_runs(samples, seed, step))) for seed in range(12)]
    assert sum(map(bool, found)) <= 2


@pytest.mark.parametrize("step", [0.0, 0.02])
@pytest.mark.parametrize("samples", LENGTHS)
def test_a_sample_far_off_in_noise_is_found(samples, step):
    [glitch] = glitches(noisy_runs(samples, 0, step, spike=0.5))
    assert glitch.code == "spike"
    assert states(glitch.text, "v_meas", "real rollout 2", "1 s" if samples > 1000 else "v_meas")


def test_a_sample_far_off_in_a_channel_that_is_constant_otherwise_is_found():
    def spike(trace):
        return changed(changed(trace, "v_meas", slice(None), 0.25), "v_meas", 40, 1.0)

    assert [each.code for each in glitches(many({}, spike))] == ["spike"]


def test_a_count_that_is_one_more_for_once_is_no_glitch():
    def counted(trace):  # iterations of a solver
        return changed(changed(trace, "v_meas", slice(None), 5.0), "v_meas", slice(60, None), 6.0)

    runs = [(test, counted(trace)) for test, trace in many({})]
    runs[3] = (runs[3][0], changed(runs[3][1], "v_meas", 40, 6.0))
    assert glitches(runs) == []


def test_a_glitch_is_a_note_and_what_to_see_to_first(cache):
    def spike(trace):
        return changed(trace, "v_meas", 40, 30.0)

    spec = s2r.parse_spec(SPEC)
    found = s2r.diagnose(spec, Cart(), many({}, spike), cache=cache, where=False)
    assert found.misread == ("v_meas",)
    assert found.notes[0].startswith("v_meas of real rollout ")
    assert " v_meas " in next_step(found, spec)
