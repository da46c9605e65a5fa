"""What the equations of motion ask for: coordinates of effects from recorded motion alone."""

import importlib
from dataclasses import replace

import numpy as np
import pytest
from s2r_cart import DAMPING, FORCE, GAIN, MASS, NOMINAL, SPEC, STEP, Cart, real

import s2r_spec as s2r
from s2r_spec.diagnose import bank as banks
from s2r_spec.diagnose.equations import SHRINKAGE, Equations, Probe, Regression
from s2r_spec.diagnose.prepare import bench_of, equations_error
from s2r_spec.diagnose.signatures import LEVEL
from s2r_spec.errors import TraceError
from s2r_spec.trace import Trace

pytestmark = pytest.mark.filterwarnings("ignore::sklearn.exceptions.ConvergenceWarning")


class Felt(Cart):
    """A cart that says which force its model, with its effects, does not explain, but for its sensor."""

    def residuals(self, trace, params=None):
        if not {"v", "u"} <= set(trace.channels):
            raise TraceError("residuals need v and u")
        e = NOMINAL | dict(self.added)
        v, u = trace["v"], trace["u"]
        late = round(e["delay"] / STEP)
        drive = e["motor"] * FORCE * np.concatenate([np.zeros(late), u[: len(u) - late]]) + e["tilt"]
        force = drive - (DAMPING + e["viscous"]) * v - e["coulomb"] * np.sign(v)
        lacking = (MASS + e["payload"]) * np.diff(v) / STEP - force[:-1]
        channels = {"force": lacking}
        if "v_meas" in trace.channels and "v_ref" in trace.channels:
            law = GAIN * (trace["v_ref"] - trace["v_meas"]) + DAMPING * trace["v_ref"]
            channels["controller"] = (u - np.clip(law, -self.limit, self.limit))[:-1]
        units = {name: {"force": "N", "controller": "V"}[name] for name in channels}
        return Trace(trace.times[:-1], channels, units, {"parts": {name: ["cart"] for name in channels}})


class Held(Felt):
    """A cart whose grease only shows where it drives harder than a nominal one does in the middle of the test space."""

    most = 0.0

    def residuals(self, trace, params=None):
        dry = replace(self, added=tuple(pair for pair in self.added if pair[0] != "viscous"))
        found = super().residuals(trace)
        hard = trace["u"][:-1] > self.most
        force = np.where(hard, found["force"], Felt.residuals(dry, trace)["force"])
        return Trace(found.times, dict(found.channels) | {"force": force}, found.units, found.meta)


class Rattling(Felt):
    """A motor that is driven as no effect of the catalogue says."""

    def rollout(self, params, seed):
        trace = super().rollout(params, seed)
        rattle = 4.0 * np.sin(np.arange(len(trace)) * 1.3)
        return Trace(trace.times, dict(trace.channels) | {"u": trace["u"] + rattle}, dict(trace.units))


UNITS = {"force": np.array([0.1])}
PROBES = (
    Probe("viscous", "coefficient", 1.0, 1.0),
    Probe("coulomb", "force", 0.7, 1.0),
    Probe("tilt", "force", 1.0, 1.0),
    Probe("delay", "delay", 0.02, 1.0),
)
EQUATIONS = Equations(Felt(), PROBES, UNITS)


def test_the_equations_ask_for_the_effects_that_are_there():
    machine = Felt().with_effects({"viscous": {"coefficient": 1.5}, "tilt": {"force": -0.5}})
    found = np.mean(
        [EQUATIONS.regressed(machine.rollout({"vd": 0.8, "acc": 3.0}, seed), {}) for seed in range(20)],
        axis=0,
    )
    # (viscous, coulomb, tilt, delay), in coordinates
    np.testing.assert_allclose(found, [1.5, 0.0, -0.5, 0.0], atol=0.15)


def test_the_equations_are_believed_as_far_as_they_explain_the_residuals():
    bench = bench_of(s2r.parse_spec(SPEC), "tracking", Felt())
    bench = replace(bench, features=banks.simulate(bench).features)
    test = {"vd": 0.8, "acc": 3.0}

    def error(machine):
        return equations_error(bench, [(test, machine.rollout(test, seed)) for seed in range(5)])

    assert error(Felt()) == error(Felt().with_effects({"viscous": {"coefficient": 1.5}})) == LEVEL
    assert error(Rattling()) > error(Felt())
    trace = Felt().rollout(test, 0)
    # of a record without what the residuals need nothing is known
    assert equations_error(bench, [(test, Trace(trace.times, {"v": trace["v"]}, {"v": "m/s"}))]) == LEVEL


def test_a_residual_that_nothing_explains_is_no_reason_to_blame_an_effect_that_shows_elsewhere():
    rng = np.random.default_rng(0)
    n = 400
    # one effect in both residuals, of which the second has something else of its own along with it
    taken = np.concatenate([np.sin(np.arange(n) / 9), np.cos(np.arange(n) / 7)])[None] * 3.0
    other = np.concatenate([np.zeros(n), 12.0 * np.cos(np.arange(n) / 7 + 0.7)])
    rest = 0.5 * taken[0] + other + 0.3 * rng.normal(size=2 * n)
    found = Regression(rest, taken, np.repeat([0, 1], n)).weighed()
    alone = Regression(rest[:n], taken[:, :n], np.zeros(n, dtype=int)).weighed()
    assert abs(alone[0] - 0.5) < 0.05
    assert abs(found[0] - 0.5) < 0.15
    equally = rest @ taken[0] / (taken[0] @ taken[0])
    assert abs(equally - 0.5) > 1.0


def test_residuals_that_are_explained_are_all_believed_alike():
    rng = np.random.default_rng(1)
    taken = rng.normal(size=(3, 300))
    rest = np.array([0.4, -1.2, 0.0]) @ taken + 0.5 * rng.normal(size=300)
    plain = np.linalg.solve(taken @ taken.T / 300 + SHRINKAGE * np.eye(3), taken @ rest / 300)
    np.testing.assert_allclose(Regression(rest, taken, np.repeat([0, 1, 2], 100)).weighed(), plain)


def test_a_motion_of_which_no_sample_is_complete_asks_for_nothing():
    empty = Regression(np.zeros(0), np.zeros((2, 0)), np.zeros(0, dtype=int))
    np.testing.assert_array_equal(empty.weighed(), [0.0, 0.0])


def test_a_record_without_what_a_residual_needs_has_no_such_numbers():
    trace = Felt().rollout({"vd": 0.8, "acc": 3.0}, 0)
    few = Trace(trace.times, {"v": trace["v"]}, {"v": "m/s"})
    assert np.isnan(EQUATIONS.regressed(few, {})).all()
    # one residual of two would be another number than that of the bank
    half = Trace(trace.times, {"v": trace["v"], "u": trace["u"]}, {"v": "m/s", "u": "V"})
    both = UNITS | {"controller": np.ones(1)}
    assert np.isnan(Equations(Felt(), PROBES, both).regressed(half, {})).all()
    assert np.isfinite(EQUATIONS.regressed(half, {})).all()


def test_only_effects_that_the_residuals_know_are_asked_for_and_the_bank_keeps_them(tmp_path):
    spec = s2r.parse_spec(SPEC)
    bench = bench_of(spec, "tracking", Felt())
    made = banks.simulate(bench)
    names = [probe.name for probe in made.features.probes]
    assert names == [
        "viscous.coefficient",
        "coulomb.force",
        "payload.mass",
        "motor.factor",
        "tilt.force",
        "delay.delay",
    ]
    banks.save(made, tmp_path / "bank.npz")
    again = banks.load(tmp_path / "bank.npz")
    assert again.features.probes == made.features.probes
    trace, test = bench.run({}, made.tests[0], 3), made.tests[0]
    rows = [replace(bench, features=one.features).measure(trace, test) for one in (made, again)]
    np.testing.assert_array_equal(*rows)
    assert len(rows[0]) == 1 + len(made.features.names())
    assert [f.block for f in made.features.names() if f.statistic == "equation"] == names
    assert not banks.simulate(bench_of(spec, "tracking", Cart())).features.probes


def test_an_effect_that_shows_only_in_a_motion_that_has_it_is_asked_for(monkeypatch):
    bench = bench_of(s2r.parse_spec(SPEC), "tracking", Held())
    tests = banks.simulate(bench_of(s2r.parse_spec(SPEC), "tracking", Cart())).tests
    middle = tests[len(tests) // 2]
    monkeypatch.setattr(Held, "most", float(bench.run({}, middle, 0)["u"].max()))
    seen = Equations(Held(), PROBES[:1], UNITS).regressors(bench.run({}, middle, 0), middle)
    assert not seen.taken.any()
    assert "viscous.coefficient" in [probe.name for probe in banks.simulate(bench).features.probes]


def test_a_pair_is_named_by_a_simulator_with_residuals(cache):
    rng = np.random.default_rng(12)
    tests = [{"vd": rng.uniform(0.2, 1), "acc": rng.uniform(1, 4)} for _ in range(30)]
    effects = {"viscous": 1.6, "delay": 0.035}
    seen = [(test, real(test, 12000 + i, effects)) for i, test in enumerate(tests)]
    found = s2r.diagnose(s2r.parse_spec(SPEC), Felt(), seen, cache=cache)
    assert found.which.ranked[0][0] == ("viscous", "delay"), found.which.ranked[:4]
    assert found.where.body is not None


def test_a_bank_is_made_anew_when_a_backend_computes_residuals_otherwise(tmp_path, monkeypatch):
    """Their source may decide no rollout, and be left out of the model's hash."""
    package = tmp_path / "s2r_felt"
    package.mkdir()
    (package / "__init__.py").write_text(
        "from s2r_cart import Cart\n\n\nclass Own(Cart):\n    def residuals(self, trace, params=None): ...\n"
    )
    (package / "law.py").write_text("GAIN = 1.0\n")
    monkeypatch.syspath_prepend(tmp_path)
    own = importlib.import_module("s2r_felt").Own
    bench = bench_of(s2r.parse_spec(SPEC), "tracking", own())
    before = banks.key(bench)
    assert banks.key(bench) == before
    (package / "law.py").write_text("GAIN = 2.0\n")
    assert banks.key(bench) != before
