"""What the equations of motion ask for: coordinates of effects from recorded motion alone."""

import importlib
from dataclasses import replace

import numpy as np
import pytest
from s2r_cart import DAMPING, FORCE, GAIN, MASS, NOMINAL, SPEC, STEP, VOLTAGE, Cart, real

import s2r_spec as s2r
from s2r_spec.backend import Effect, EffectParameter
from s2r_spec.diagnose import bank as banks
from s2r_spec.diagnose.axes import line
from s2r_spec.diagnose.cache import Cache
from s2r_spec.diagnose.equations import Equations, Probe
from s2r_spec.diagnose.prepare import bench_of, equations_error
from s2r_spec.diagnose.signatures import LEVEL
from s2r_spec.errors import BackendError, TraceError
from s2r_spec.trace import Trace

# Parts of the first design, which go when the second answers.
pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::sklearn.exceptions.ConvergenceWarning")]


LINE = SPEC.replace("acc {m/s^2} in [1, 4]", "acc {m/s^2} = 2.5")
"""One parameter: half as many tests, where the figures do not hang on them."""


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


LOWERED = Effect(
    "lowered",
    "actuation",
    "A lower limit of the voltage.",
    (EffectParameter("part", "", 0.1, 1.0, 1.0, "1 minus half-normal, 0.3"),),
)


class Limited(Felt):
    """With an effect more: a limit of the voltage, which no nominal motion reaches where it is typical."""

    def effects(self):
        return (*super().effects(), LOWERED)

    def with_effects(self, values):
        found = super().with_effects({name: of for name, of in values.items() if name != "lowered"})
        return replace(found, limit=VOLTAGE * values.get("lowered", {}).get("part", 1.0))


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


def test_the_equations_are_believed_as_far_as_they_explain_the_residuals(felt):
    bench = replace(bench_of(s2r.parse_spec(SPEC), "tracking", Felt()), features=felt)
    test = {"vd": 0.8, "acc": 3.0}

    def error(machine):
        return equations_error(bench, [(test, machine.rollout(test, seed)) for seed in range(5)])

    assert error(Felt()) == error(Felt().with_effects({"viscous": {"coefficient": 1.5}})) == LEVEL
    assert error(Rattling()) > error(Felt())
    trace = Felt().rollout(test, 0)
    # of a record without what the residuals need nothing is known
    assert equations_error(bench, [(test, Trace(trace.times, {"v": trace["v"]}, {"v": "m/s"}))]) == LEVEL


@pytest.fixture(scope="module")
def bank(cache):
    return banks.bank(
        bench_of(s2r.parse_spec(SPEC), "tracking", Felt()), cache=Cache(cache.with_name("quick"))
    )


@pytest.fixture(scope="module")
def felt(bank):
    return bank.features


def coordinates(features, values):
    """Return (probes,) of an effect each at these values."""
    x = np.zeros(len(features.probes))
    for place, probe in enumerate(features.probes):
        if probe.effect in values:
            off = values[probe.effect] - NOMINAL[probe.effect]
            x[place] = off * probe.coordinate / (probe.value - NOMINAL[probe.effect])
    return x


def by_force(features, voids):
    return Equations(Felt(), features.probes, {"force": features.residual_units()["force"]}, voids)


def mean_asked(equations, machine, test, instruments=None):
    return np.mean(
        [equations.regressed(machine.rollout(test, k), test, instruments) for k in range(8)], axis=0
    )


def test_no_model_at_all_explains_any_motion_and_is_not_asked_for(felt):
    # without mass, damping and motor there would be no force
    void = coordinates(felt, {"payload": -MASS, "motor": 0.0, "viscous": -DAMPING})
    assert list(felt.voids) == ["force"]  # the controller's residual is there without a cart
    assert np.dot(felt.voids["force"], void) == pytest.approx(1.0, abs=1e-3)
    test, place = {"vd": 0.8, "acc": 3.0}, [probe.effect for probe in felt.probes].index
    rattling = Rattling().with_effects({"viscous": {"coefficient": 1.5}})
    free, scaled = by_force(felt, {}), by_force(felt, felt.voids)
    nominal = [Felt().rollout(test, seed) for seed in (100, 101, 102)]
    for instruments in (None, free.instruments(nominal, test)):
        nearly = mean_asked(free, rattling, test, instruments)
        assert np.linalg.norm(nearly - void) < 0.6 * np.linalg.norm(void)
    found = np.abs(mean_asked(scaled, rattling, test, scaled.instruments(nominal, test)))
    assert int(found.argmax()) == place("viscous")
    assert max(found[place("payload")], found[place("motor")]) < 0.2


def voids(features, effects=NOMINAL):
    """Find them with the effects that are given, of which alone the equations are asked."""
    bench = bench_of(s2r.parse_spec(SPEC), "tracking", Felt())
    found = tuple(
        line(effect, effect.parameters[0]) for effect in bench.backend.effects() if effect.name in effects
    )
    probes = tuple(probe for probe in features.probes if probe.effect in effects)
    tests = [{"vd": 0.8, "acc": 3.0}, {"vd": 0.4, "acc": 2.0}]
    return banks._voids(bench, replace(features, probes=probes, voids={}), found, tests, None)


def test_an_effect_that_explains_itself_is_not_no_model_at_all(felt):
    assert voids(felt, effects=("viscous",)) == {}
    assert voids(felt, effects=("viscous", "payload")) == {}
    assert list(voids(felt, effects=("viscous", "payload", "motor"))) == ["force"]


def test_a_simulator_without_noise_is_nothing_likewise(felt, monkeypatch):
    class Quiet:
        def normal(self, size=None):
            return np.zeros(size) if size else 0.0

    usual = voids(felt)["force"]
    monkeypatch.setattr(np.random, "default_rng", lambda seed: Quiet())
    assert voids(felt)["force"] == pytest.approx(usual, abs=1e-3)


class Driven(Felt):
    """Its force on the motor is measured, too: what that says of the motor holds as it is."""

    def rollout(self, params, seed):
        trace = super().rollout(params, seed)
        pull = (NOMINAL | dict(self.added))["motor"] * FORCE * trace["u"]
        return Trace(trace.times, dict(trace.channels) | {"pull": pull}, dict(trace.units) | {"pull": "N"})

    def residuals(self, trace, params=None):
        found = super().residuals(trace, params)
        drive = trace["pull"] - (NOMINAL | dict(self.added))["motor"] * FORCE * trace["u"]
        noise = 0.01 * np.sin(np.arange(len(drive)) * 1.7)
        return Trace(
            found.times,
            dict(found.channels) | {"drive": (drive + noise)[:-1]},
            dict(found.units) | {"drive": "N"},
            {"parts": {name: ["cart"] for name in (*found.channels, "drive")}},
        )


def test_what_another_residual_says_of_an_effect_is_asked_of_both():
    features = banks.simulate(bench_of(s2r.parse_spec(LINE), "tracking", Driven())).features
    assert features.voids == {}
    weak = Driven().with_effects({"motor": {"factor": 0.6}})
    found = mean_asked(features.asked(Driven()), weak, {"vd": 0.8, "acc": 3.0})
    np.testing.assert_allclose(found, coordinates(features, {"motor": 0.6}), atol=0.05)


def test_coordinates_are_asked_for_in_parts_of_what_is_left_of_the_model(felt):
    g = np.array(felt.voids["force"])
    weaker = Felt().with_effects({"motor": {"factor": 0.6}})
    found = mean_asked(by_force(felt, felt.voids), weaker, {"vd": 0.8, "acc": 3.0})
    x = coordinates(felt, {"motor": 0.6})
    # of no model at all nothing is known: along that the ridge has its way
    across = np.eye(len(g)) - np.outer(g, g) / (g @ g)
    np.testing.assert_allclose(across @ found, across @ (x / (1.0 - g @ x)), atol=0.05)
    assert np.abs(across @ found - across @ x).max() > 0.05


def test_a_residual_without_a_single_instant_is_not_taken_for_an_absent_effect():
    trace = Felt().with_effects({"viscous": {"coefficient": 1.5}}).rollout({"vd": 0.8, "acc": 3.0}, 0)
    lost = Trace(trace.times, dict(trace.channels) | {"v": np.full(len(trace), np.nan)}, trace.units)
    assert np.isnan(EQUATIONS.regressed(lost, {})).all()
    assert np.isnan(EQUATIONS.unexplained(lost, {}))
    # some instants are enough
    some = trace["v"].copy()
    some[: len(trace) // 2] = np.nan
    half = Trace(trace.times, dict(trace.channels) | {"v": some}, trace.units)
    assert EQUATIONS.regressed(half, {})[0] == pytest.approx(1.5, abs=0.4)


def test_residuals_at_other_instants_with_an_effect_are_told_of():
    class Shorter(Felt):
        def residuals(self, trace, params=None):
            found = super().residuals(trace, params)
            if "delay" not in dict(self.added):
                return found
            channels = {name: values[5:] for name, values in found.channels.items()}
            return Trace(found.times[5:], channels, found.units, found.meta)

    trace = Felt().rollout({"vd": 0.8, "acc": 3.0}, 0)
    with pytest.raises(BackendError, match=r"'delay'.* instants"):
        Equations(Shorter(), PROBES, UNITS).regressed(trace, {})


def test_a_record_without_what_a_residual_needs_has_no_such_numbers():
    trace = Felt().rollout({"vd": 0.8, "acc": 3.0}, 0)
    few = Trace(trace.times, {"v": trace["v"]}, {"v": "m/s"})
    assert np.isnan(EQUATIONS.regressed(few, {})).all()
    # one residual of two would be another number than that of the bank
    half = Trace(trace.times, {"v": trace["v"], "u": trace["u"]}, {"v": "m/s", "u": "V"})
    both = UNITS | {"controller": np.ones(1)}
    assert np.isnan(Equations(Felt(), PROBES, both).regressed(half, {})).all()
    assert np.isfinite(EQUATIONS.regressed(half, {})).all()


def test_only_effects_that_the_residuals_know_are_asked_for_and_the_bank_keeps_them(tmp_path, cache):
    bench = bench_of(s2r.parse_spec(LINE), "tracking", Felt())
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
    assert again.features.voids == made.features.voids
    trace, test = bench.run({}, made.tests[0], 3), made.tests[0]
    rows = [replace(bench, features=one.features).measure(trace, test) for one in (made, again)]
    np.testing.assert_array_equal(*rows)
    assert len(rows[0]) == 1 + len(made.features.names())
    assert [f.block for f in made.features.names() if f.statistic == "equation"] == names
    plain = bench_of(s2r.parse_spec(SPEC), "tracking", Cart())
    assert not banks.bank(plain, cache=Cache(cache)).features.probes


@pytest.mark.slow
def test_what_shows_in_no_nominal_motion_is_asked_for_where_it_is_far_off():
    bench = bench_of(s2r.parse_spec(SPEC), "tracking", Limited())
    found = banks.simulate(bench).features.probes
    last = found[-1]
    assert (last.effect, last.idle) == ("lowered", True)
    assert last.coordinate < -1.4
    assert not any(probe.idle for probe in found[:-1])
    machine = Limited().with_effects({"lowered": {"part": last.value}})
    asked = Equations(Limited(), found, {"force": np.array([0.1]), "controller": np.array([0.1])})
    there, not_there = (
        asked.regressed(m.rollout({"vd": 0.8, "acc": 3.0}, 0), {})[-1] for m in (machine, Limited())
    )
    assert there == pytest.approx(last.coordinate, abs=0.1)
    assert not_there == pytest.approx(0.0, abs=0.1)


class Creeping(Felt):
    """It slips where it lags further behind than it does with nothing wrong; no effect explains that."""

    def residuals(self, trace, params=None):
        found = super().residuals(trace, params)
        lag = np.abs(trace["v_ref"] - trace["v"])[:-1]
        slip = 1e3 * np.maximum(lag - 0.16 * params["acc"], 0.0)
        return Trace(
            found.times,
            dict(found.channels) | {"slip": slip},
            dict(found.units) | {"slip": "m/s^3"},
            {"parts": {name: ["cart"] for name in (*found.channels, "slip")}},
        )


def test_what_the_equations_leave_is_told_of_each_residual():
    machine = Felt().with_effects({"viscous": {"coefficient": 1.5}})
    trace = machine.rollout({"vd": 0.8, "acc": 3.0}, 0)
    left = EQUATIONS.left(trace, {})
    bare = machine.residuals(trace)["force"] / 0.1
    explained = Felt().residuals(trace)["force"] / 0.1
    assert left["force"] == pytest.approx(np.sqrt((bare**2).mean()), rel=0.1)
    assert left["force"] < 0.2 * np.sqrt((explained**2).mean())
    assert np.sqrt(EQUATIONS.unexplained(trace, {})) == pytest.approx(float(left["force"][0]), rel=1e-6)
    assert EQUATIONS.left(Trace(trace.times, {"v": trace["v"]}, {"v": "m/s"}), {}) is None


@pytest.mark.slow
def test_a_residual_is_measured_in_what_a_little_of_everything_leaves_of_it(felt):
    creeping = banks.simulate(bench_of(s2r.parse_spec(SPEC), "tracking", Creeping()))
    units, scale = creeping.features.residual_units(), felt.residual_units()
    # A model that explains what effects do is measured as before; what it does not explain is believed less.
    for name, unit in scale.items():
        assert units[name] == pytest.approx(unit, rel=0.3), name
    alone = creeping.features.scale[[b.source == "residual.slip" for b in creeping.features.blocks]]
    assert units["slip"] > 1.5 * alone


def test_an_effect_that_cannot_be_asked_of_a_nominal_motion_silences_no_other():
    class Fussy(Felt):
        def residuals(self, trace, params=None):
            if "coulomb" in dict(self.added) and trace["u"].max() < 4.6:
                raise TraceError("not of so gentle a motion")
            return super().residuals(trace, params)

    bench = bench_of(s2r.parse_spec(LINE), "tracking", Fussy())
    made = banks.simulate(bench)
    names = [probe.effect for probe in made.features.probes]
    assert "coulomb" not in names
    assert "viscous" in names
    middle = made.tests[len(made.tests) // 2]
    row = replace(bench, features=made.features).measure(bench.run({}, middle, 0), middle)
    assert np.isfinite(row[-len(names) :]).all()


@pytest.mark.slow
def test_a_pair_is_named_by_a_simulator_with_residuals(quick):
    rng = np.random.default_rng(12)
    tests = [{"vd": rng.uniform(0.2, 1), "acc": rng.uniform(1, 4)} for _ in range(30)]
    effects = {"viscous": 1.6, "delay": 0.035}
    seen = [(test, real(test, 12000 + i, effects)) for i, test in enumerate(tests)]
    found = s2r.diagnose(s2r.parse_spec(SPEC), Felt(), seen, cache=quick)
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
