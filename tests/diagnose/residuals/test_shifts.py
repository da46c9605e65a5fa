"""Which part, when, how large: on residuals that are made up, on the cart and on the axis."""

import json
from dataclasses import dataclass, replace

import numpy as np
import pytest
from s2r_cart import DAMPING, GAIN, MASS, SPEC, Cart, real

import s2r_spec as s2r
from s2r_spec.base.json_values import to_json
from s2r_spec.diagnose.gap.where import body_of, locate
from s2r_spec.diagnose.residuals.cells import CELLS
from s2r_spec.diagnose.residuals.shifts import Residuals, shifts, windows
from s2r_spec.diagnose.simulator.bench import Bench
from s2r_spec.errors import TraceError
from s2r_spec.runs.compatibility import check_compatibility
from s2r_spec.runs.seeds import SeedStream, rollout_seed
from s2r_spec.trace import Trace

UNITS = {"torque": "N*m", "speed": "m/s"}
PARTS = {"torque": ("left hip", "left knee", "right hip"), "speed": ("encoder",)}
AXIS = """
signal q {m}
signal q_ref {m}
param  speed {m/s} in [0.05, 0.24]
require tracks: always[0, 1 s] (abs(q - q_ref) <= 2 {mm})
"""


@dataclass(frozen=True)
class CartWithResiduals(Cart):
    """The cart that says what its model leaves unexplained: a force, a voltage, a speed."""

    def residuals(self, trace, params=None):
        if not {"v", "u", "v_ref", "v_meas"} <= set(trace.channels):
            raise TraceError("residuals need v, v_ref, v_meas and u")
        v, u = trace["v"], trace["u"]
        force = MASS * np.gradient(v, trace.times) + DAMPING * v - u
        law = np.clip(GAIN * (trace["v_ref"] - trace["v_meas"]) + DAMPING * trace["v_ref"], -12, 12)
        return Trace(
            trace.times,
            {"force": force, "controller": u - law, "speed": trace["v_meas"] - v},
            {"force": "N", "controller": "V", "speed": "m/s"},
            {"parts": {"force": ["wheels"], "controller": ["controller"], "speed": ["encoder"]}},
        )


def made_up(rng, shift=lambda t: 0.0, samples=160):
    """Return residuals of white noise in each column, the left knee's torque shifted."""
    t = np.arange(samples) / samples
    torque = rng.normal(size=(samples, 3))
    torque[:, 1] += shift(t)
    trace = Trace(t, {"torque": torque, "speed": 0.01 * rng.normal(size=samples)}, UNITS, {"parts": PARTS})
    return Residuals(trace, trace)


def cut(trace, samples):
    return Trace(
        trace.times[:samples],
        {name: values[:samples] for name, values in trace.channels.items()},
        trace.units,
        trace.meta,
    )


def compare(seed, shift=lambda t: 0.0, n=12):
    rng = np.random.default_rng(seed)
    tests = rng.uniform(-1, 1, (n, 1))
    own = [made_up(rng, shift) for _ in range(n)]
    return shifts(tests, own, [[made_up(rng), made_up(rng)] for _ in range(n)], 1.0)


def bench_of(backend, text=SPEC):
    spec = s2r.parse_spec(text)
    name = spec.requirements[0]
    return Bench(backend, spec, name, check_compatibility(spec, name, backend))


def answer(bench, rollouts, seed=0, only_body=False):
    """Return where, as a diagnosis asks for it."""
    if only_body:
        simulated = [
            (test, bench.run({}, test, rollout_seed(seed, number, 0, SeedStream.CHECK)))
            for number, (test, _) in enumerate(rollouts)
        ]
        return body_of(bench, rollouts, simulated, seed)
    return locate(bench, rollouts, {}, seed)


def machine(effects, case, n=16, extra=None, background=0.05):
    rng = np.random.default_rng(case)
    tests = [{"vd": rng.uniform(0.2, 1), "acc": rng.uniform(1, 4)} for _ in range(n)]
    return [
        (test, real(test, 1000 * case + i, effects, background=background, extra=extra))
        for i, test in enumerate(tests)
    ]


def test_windows_double_and_cover_everything():
    found = windows()
    assert {end - begin for begin, end in found} == {1, 2, 4, 8, 16, 32}
    assert (0, CELLS) in found
    assert len(set(found)) == len(found)
    for length in (1, 2, 4, 8, 16, 32):
        assert {cell for begin, end in found if end - begin == length for cell in range(begin, end)} == set(
            range(CELLS)
        )


def test_a_shift_is_found_in_its_part_and_window_and_sized():
    found = compare(1, lambda t: 1.5 * ((t >= 0.5) & (t < 0.75)))
    assert [part.name for part in found.shifted] == ["left knee"]
    shift = found.parts[0].shifts[0]
    assert (shift.channel, shift.column, shift.kind, shift.unit) == ("torque", 1, "mean", "N*m")
    assert (shift.begin, shift.end) == (0.5, 0.75)
    assert shift.mean == pytest.approx(1.5, abs=0.15)
    assert shift.size == pytest.approx(1.5, abs=0.15)
    # 40 samples of standard deviation 1
    assert shift.sigma == pytest.approx(1.5 * np.sqrt(40), rel=0.35)
    assert shift.p <= shift.adjusted < 1e-4
    assert {part.name for part in found.parts} == {"left hip", "left knee", "right hip", "encoder"}


def test_a_shift_that_changes_sign_with_the_test_is_found():
    rng = np.random.default_rng(2)
    tests = np.linspace(-1, 1, 12)[:, None]
    own = [made_up(rng, lambda t, d=float(d): 2.0 * d) for (d,) in tests]
    found = shifts(tests, own, [[made_up(rng), made_up(rng)] for _ in tests], 1.0)
    assert [part.name for part in found.shifted] == ["left knee"]
    shift = found.parts[0].shifts[0]
    assert abs(shift.mean) < 0.2
    assert shift.size == pytest.approx(2.0 * np.sqrt((tests**2).mean()), rel=0.2)


def test_what_changes_its_sign_with_the_motion_is_found_by_its_size():
    rng = np.random.default_rng(8)
    found = compare(6, lambda t: 2.0 * np.sign(rng.normal(size=t.size)) * (t >= 0.5))
    assert [part.name for part in found.shifted] == ["left knee"]
    shift = found.parts[0].shifts[0]
    assert (shift.kind, shift.begin, shift.end) == ("rms", 0.5, 1.0)
    assert shift.mean == pytest.approx(np.sqrt(5) - 1, rel=0.1)


@pytest.mark.parametrize(("seeds", "most"), [(20, 1), pytest.param(60, 3, marks=pytest.mark.slow)])
def test_nothing_is_found_where_nothing_is(seeds, most):
    assert sum(bool(compare(seed).shifted) for seed in range(seeds)) <= most


def test_rounding_is_no_shift():
    rng = np.random.default_rng(3)
    quiet = [made_up(rng) for _ in range(8)]
    own = [
        Residuals(Trace(one.trace.times, {"motor": np.full(160, value)}, {"motor": "N*m"}), one.recorded)
        for one, value in zip(quiet, [1e-14] * 8, strict=True)
    ]
    other = [
        [Residuals(Trace(one.trace.times, {"motor": np.zeros(160)}, {"motor": "N*m"}), one.recorded)] * 2
        for one in quiet
    ]
    found = shifts(np.zeros((8, 0)), own, other, 1.0)
    assert [part.name for part in found.parts] == ["motor"]  # a backend that names no parts
    assert not found.shifted


def test_a_residual_that_rollouts_lack_takes_no_other_along():
    rng = np.random.default_rng(1)
    tests = rng.uniform(-1, 1, (12, 1))

    def lacking(one, columns):
        torque = one.trace["torque"].copy()
        torque[:, columns] = np.nan
        return one._replace(trace=replace(one.trace, channels={**one.trace.channels, "torque": torque}))

    whole = [made_up(rng, lambda t: 1.5 * ((t >= 0.5) & (t < 0.75))) for _ in range(12)]
    own = [lacking(one, [2] if number else [0, 2]) for number, one in enumerate(whole)]
    other = [[made_up(rng), made_up(rng)] for _ in range(12)]
    found = shifts(tests, own, other, 1.0)
    assert [part.name for part in found.shifted] == ["left knee"]
    # Of the right hip nothing is known of any rollout, and nothing is asked; of the left one of all but one.
    assert found.asked == 2 * 3 * len(windows())
    none = shifts(tests, [lacking(one, [0, 1, 2]) for one in whole], other, 1.0)
    assert none.asked == 2 * len(windows())


def test_what_ended_early_says_nothing_of_later():
    rng = np.random.default_rng(4)
    own = [made_up(rng, lambda t: np.where(t >= 0.5, 5.0, 0.0)) for _ in range(10)]
    short = [Residuals(cut(one.trace, 64), one.recorded) for one in own]
    other = [[made_up(rng), made_up(rng)] for _ in range(10)]
    assert shifts(np.zeros((10, 0)), own, other, 1.0).shifted
    assert not shifts(np.zeros((10, 0)), short, other, 1.0).shifted


@pytest.mark.parametrize(
    ("effects", "part", "channel"),
    [({"coulomb": 1.5}, "wheels", "force"), ({"speed_scale": 0.85}, "encoder", "speed")],
)
def test_the_cart_shows_its_effect_where_it_acts(effects, part, channel):
    found = answer(bench_of(CartWithResiduals()), machine(effects, case=11))
    first = found.body.parts[0]
    assert first.name == part
    assert first.shifts[0].channel == channel
    assert found.no_body is None
    # The controller does what its law says, whatever the machine does with it.
    assert "controller" not in {one.name for one in found.body.shifted}
    json.dumps(to_json(found), allow_nan=False)


def test_a_gust_on_the_cart_is_found_when_it_blows():
    found = answer(bench_of(CartWithResiduals()), machine({}, case=5, extra="gust", background=0.0, n=24))
    shift = next(part for part in found.body.shifted if part.name == "wheels").shifts[0]
    # 6 N for 0.3 s, from between 0.4 and 1 s on
    assert shift.begin >= 0.3
    assert shift.end <= 1.5  # windows double: half a second is too short for all of them
    assert shift.mean > 1.0


def test_a_cart_like_its_simulator_shows_nothing():
    backend = CartWithResiduals()
    bench = bench_of(backend)
    alarms = 0
    for case in range(5):
        rng = np.random.default_rng(case)
        tests = [{"vd": rng.uniform(0.2, 1), "acc": rng.uniform(1, 4)} for _ in range(10)]
        own = [(test, backend.rollout(test, 777_000 + 100 * case + i)) for i, test in enumerate(tests)]
        found, why = answer(bench, own, case, only_body=True)
        assert why is None
        alarms += bool(found.shifted)
    assert alarms == 0


def test_the_axis_shows_friction_at_its_carriage():
    backend = s2r.load_backend("emps").with_duration(1.0)
    machine = backend.with_effects({"coulomb": {"force": 20.0}})
    tests = [{"speed": 0.06 + 0.02 * i} for i in range(8)]
    bench = bench_of(backend, AXIS)
    own = [(test, machine.rollout(bench.matched.to_backend(test), 500 + i)) for i, test in enumerate(tests)]
    found = answer(bench, own)
    assert [part.name for part in found.body.shifted] == ["carriage"]
    shift = found.body.parts[0].shifts[0]
    assert shift.unit == "N"
    assert shift.mean == pytest.approx(-20.0, rel=0.1)


def test_a_backend_without_residuals_and_logs_without_channels_are_told_in_a_sentence():
    bare = answer(bench_of(Cart()), machine({"coulomb": 1.5}, 3, n=6))
    assert bare.body is None
    assert "computes no residuals" in bare.no_body
    assert bare.body is None
    short = [(test, trace.only(["v", "v_ref"])) for test, trace in machine({"coulomb": 1.5}, 3, n=6)]
    found = answer(bench_of(CartWithResiduals()), short)
    assert found.body is None
    assert "residuals need v, v_ref" in found.no_body
    assert "v, v_ref, v_meas and u" in found.no_body
