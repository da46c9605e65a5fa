"""What recordings are in the simulator's terms, and what is said of what they lack."""

from dataclasses import replace

import numpy as np
import pytest
from s2r_cart import SPEC, Cart, real
from s2r_spec.diagnose.ask import as_simulated, cut, read_at, real_rollouts
from s2r_spec.diagnose.held_out import mostly_of_one
from s2r_spec.diagnose.how_far import how_far
from s2r_spec.diagnose.next_test import next_test
from s2r_spec.diagnose.parted import ENOUGH, split
from s2r_spec.diagnose.signatures import Curve, Signatures
from s2r_spec.report.nextstep import next_step

import s2r_spec as s2r
from s2r_spec import logs
from s2r_spec.backend import Channel
from s2r_spec.diagnose import bank as banks
from s2r_spec.diagnose.axes import line, lines
from s2r_spec.diagnose.cache import Cache
from s2r_spec.diagnose.notes import Used, hidden_by_one, notes
from s2r_spec.diagnose.quality.direct import direct
from s2r_spec.diagnose.quality.wrapped import wrapped as jumping
from s2r_spec.diagnose.simulate import Bench
from s2r_spec.effects import catalogue_of
from s2r_spec.errors import BackendError, TraceError, UsageError
from s2r_spec.trace import Trace

pytestmark = pytest.mark.filterwarnings("ignore::sklearn.exceptions.ConvergenceWarning")
TEST = {"vd": 0.8, "acc": 3.0}
BENCH = Bench.of(s2r.parse_spec(SPEC), "tracking", Cart())


def misread(bench, runs, found=()):
    """Return channel → what is said of it."""
    return {each.channel: each.text for each in direct(bench, runs, found)}


def recorded(**changes):
    """Return a trace of the cart, with channels in other units, or other channels."""
    trace = Cart().rollout(TEST, 0)
    channels, units = dict(trace.channels), dict(trace.units)
    for name, (values, unit) in changes.items():
        channels[name] = values
        units[name] = unit
    return Trace(trace.times, channels, {n: u for n, u in units.items() if u})


def many(count, tests, spoil=lambda trace: trace):
    made = [{"vd": 0.2 + 0.8 * k / tests, "acc": 2.0} for k in range(tests)]
    return [(made[i % tests], spoil(real(made[i % tests], i, {}))) for i in range(count)]


def test_a_channel_in_another_unit_is_converted_and_one_without_is_taken_as_it_is():
    plain = Cart().rollout(TEST, 0)
    slow = as_simulated(recorded(v=(plain["v"] * 3.6, "km/h"), u=(plain["u"], "")), Cart())
    np.testing.assert_allclose(slow["v"], plain["v"], rtol=1e-12)
    np.testing.assert_array_equal(slow["u"], plain["u"])
    assert slow.units["v"] == "m/s"


def test_of_a_longer_recording_what_the_simulator_has_is_used():
    plain = Cart().rollout(TEST, 0)
    step = plain.times[1] - plain.times[0]
    more = np.concatenate([plain.times, plain.times[-1] + step * np.arange(1, 200)]) + 7.0
    channels = {name: np.concatenate([x, np.full(199, 5.0)]) for name, x in plain.channels.items()}
    longer = Trace(more, channels, plain.units)
    found = cut(longer, Cart().duration)
    assert abs(len(found) - len(plain)) <= 1
    np.testing.assert_array_equal(found["u"][: len(plain)], plain["u"][: len(found)])
    assert cut(plain, Cart().duration) is plain
    # When it fell is part of what a fall says.
    fell = Trace(more, channels, plain.units, {"failure": "fall"})
    assert cut(fell, Cart().duration) is fell


def test_that_recordings_are_longer_is_told():
    tests = many(8, 8)
    longer = [(test, cut(trace, Cart().duration / 2)) for test, trace in tests]
    [note] = notes(BENCH, Used(longer, 8, False, 3, 8), ENOUGH)
    assert note.startswith("8 of 8 real rollouts")
    assert f" {Cart().duration / 2:g} s " in note


def test_what_is_no_number_is_not_there():
    plain = Cart().rollout(TEST, 0)
    broken = plain["u"].copy()
    broken[3:6] = np.inf
    seen = as_simulated(recorded(u=(broken, "V")), Cart())["u"]
    assert np.isnan(seen[3:6]).all()
    assert np.isfinite(seen[6:]).all()


@pytest.mark.parametrize(("unit", "words"), [("A", ("in A,", " V ", "'cart'")), ("volts!", ("'volts!'",))])
def test_a_unit_that_does_not_convert_gets_one_sentence(unit, words):
    trace = recorded(u=(Cart().rollout(TEST, 0)["u"], unit))
    with pytest.raises(UsageError, match="'u'") as raised:
        as_simulated(trace, Cart())
    for word in words:
        assert word in str(raised.value)


@pytest.mark.slow
def test_declared_units_do_not_change_the_diagnosis(cache):
    rng = np.random.default_rng(4)
    tests = [{"vd": rng.uniform(0.2, 1), "acc": rng.uniform(1, 4)} for _ in range(12)]
    runs = [(test, real(test, 400 + i, {"coulomb": 1.6})) for i, test in enumerate(tests)]

    def in_other_units(trace):
        channels = {n: x * (100.0 if n.startswith("v") else 1000.0) for n, x in trace.channels.items()}
        units = {n: "cm/s" if n.startswith("v") else "mV" for n in trace.channels}
        return replace(trace, channels=channels, units=units)

    spec = s2r.parse_spec(SPEC)
    plain, other = (
        s2r.diagnose(spec, Cart(), some, cache=cache, where=False)
        for some in (runs, [(test, in_other_units(trace)) for test, trace in runs])
    )
    assert plain.which.answer == other.which.answer == ("coulomb",)
    for one, two in zip(plain.which.estimates, other.which.estimates, strict=True):
        assert two.value == pytest.approx(one.value, rel=1e-6)


def test_nothing_is_said_of_rollouts_that_lack_nothing():
    runs = many(30, ENOUGH[0])
    _, held = split(runs, 0)
    assert held
    assert notes(BENCH, Used(runs, len(runs), False, len(held), len(runs)), ENOUGH) == ()


def test_as_few_tests_as_are_told_are_enough_to_hold_some_out():
    assert split(many(30, ENOUGH[0]), 0)[1]
    assert not split(many(30, ENOUGH[0] - 1), 0)[1]


def test_falls_missing_channels_few_tests_and_a_cut_budget_are_told():
    def fallen(trace):
        return replace(trace, meta=dict(trace.meta) | {"failure": "fall"})

    def bare(trace):
        rest = {n: x for n, x in trace.channels.items() if n != "v_meas"} | {"u": np.full(len(trace), np.nan)}
        return Trace(trace.times, rest, {n: trace.units[n] for n in rest})

    some = [(test, fallen(trace) if i < 4 else trace) for i, (test, trace) in enumerate(many(10, 5, bare))]
    texts = notes(BENCH, Used(some, 10, True, 0, 25), ENOUGH)
    assert "the first 10 of 25 recorded rollouts" in texts[0]
    assert texts[1].startswith("4 of 10 real rollouts ended early (fall)")
    assert texts[2].startswith("the real rollouts have no v_meas, u")
    assert "12 rollouts of 9 different tests" in texts[3]
    assert texts[3].endswith("10 of 5")
    one = Bench.of(s2r.parse_spec(SPEC.replace("in [1, 4]", "= 2")), "tracking", Cart())
    [others] = notes(one, Used(many(12, 9), 12, False, 4, 12, 5), ENOUGH)
    assert others.startswith("5 recorded rollouts were not used")
    assert " acc " in others
    text = SPEC.replace("in [1, 4]", "= 2").replace("in [0.2, 1]", "= 0.5").partition("certify")[0]
    none = Bench.of(s2r.parse_spec(text), "tracking", Cart())
    alone = [({}, trace) for _, trace in many(8, 1)]
    [few] = notes(none, Used(alone, 8, False, 0, 8), ENOUGH)
    assert "9 rollouts" in few
    assert few.endswith(" 8")
    assert len(split([({}, trace) for _, trace in many(9, 1)], 0)[1]) == 3
    every = [(test, fallen(trace)) for test, trace in some]
    assert notes(BENCH, Used(every, 10, False, 3, 10), ENOUGH)[0].startswith(
        "10 of 10 real rollouts ended early"
    )
    assert notes(BENCH, Used(some[3:], 6, False, 3, 7), ENOUGH)[0].startswith(
        "1 of 7 real rollouts ended early (fall)"
    )
    [one] = notes(BENCH, Used(many(12, 1), 12, False, 4, 12), ENOUGH)
    assert one.startswith("all real rollouts repeat one test")


@pytest.mark.parametrize(("times", "words"), [(1e3, "about 1000 times"), (np.pi / 180.0, "about a 57th of")])
def test_a_channel_in_a_unit_that_was_not_said_is_told(times, words):
    def spoilt(trace):
        units = {name: unit for name, unit in trace.units.items() if name != "v_meas"}
        return Trace(
            trace.times, dict(trace.channels) | {"v_meas": times * trace["v_meas"]}, units, trace.meta
        )

    odd = direct(BENCH, many(12, 9, spoilt))
    [one] = notes(BENCH, Used(many(12, 9, spoilt), 12, False, 4, 12), ENOUGH, odd=odd)
    assert one.startswith(f"v_meas of the real rollouts is {words} ")
    assert " m/s" in one


class Blind(Cart):
    """A cart whose residuals need a channel that no recording has."""

    def residuals(self, trace, params):
        raise TraceError("the channel 'nothing' is missing")


def test_that_the_equations_could_not_be_asked_is_told():
    bench = Bench.of(s2r.parse_spec(SPEC), "tracking", Blind())
    [one] = notes(bench, Used(many(12, 9), 12, False, 4, 12), ENOUGH)
    assert "(the channel 'nothing' is missing)" in one


def test_what_changes_nothing_is_told():
    [one] = notes(BENCH, Used(many(12, 9), 12, False, 4, 12), ENOUGH, ("paint", "name"))
    assert "paint, name" in one


def test_a_recording_that_ends_too_early_is_named_by_its_file(tmp_path):
    for i, (test, trace) in enumerate(many(8, 8)):
        short = (
            trace
            if i != 5
            else Trace(trace.times[:50], {n: x[:50] for n, x in trace.channels.items()}, trace.units)
        )
        s2r.write_trace(short, tmp_path / f"r{i}.npz")
        with (tmp_path / "rollouts.csv").open("a") as table:
            table.write(("id,vd,acc\n" if not i else "") + f"r{i},{test['vd']},{test['acc']}\n")
    bench = Bench.of(s2r.parse_spec(SPEC), "tracking", Cart())
    with pytest.raises(
        UsageError, match=r"r5\.npz: 'tracking' looks 1\.99 s ahead, but the trace lasts 0\.49 s; leave"
    ):
        real_rollouts(bench, f"log:{tmp_path}", None, 0)


def slower(trace, step):
    """Return the trace as a logger would have it that keeps a sample now and then."""
    every = round(step / (trace.times[1] - trace.times[0]))
    return Trace(trace.times[::every], {n: x[::every] for n, x in trace.channels.items()}, trace.units)


def test_recordings_whose_samples_miss_an_end_of_a_window_are_used_as_they_are():
    runs = many(8, 8)
    slow = [(test, slower(trace, 0.03)) for test, trace in runs]
    read = real_rollouts(BENCH, slow, None, 0)
    for (test, found), (_, before), (_, trace) in zip(read, slow, runs, strict=True):
        np.testing.assert_array_equal(np.diff(found.times), np.diff(before.times))
        assert BENCH.rho(found, test) == pytest.approx(BENCH.rho(trace, test), abs=0.02)
    assert notes(BENCH, Used(read, 8, False, 3, 8), ENOUGH) == ()


def test_where_a_window_is_shorter_than_the_time_between_samples_the_simulators_are_read():
    short = Bench.of(s2r.parse_spec(SPEC.replace("[0, 1.99 s]", "[1.98 s, 1.99 s]")), "tracking", Cart())
    runs = many(8, 8)
    read = real_rollouts(short, [(test, slower(trace, 0.03)) for test, trace in runs], None, 0)
    for (test, found), (_, trace) in zip(read, runs, strict=True):
        np.testing.assert_allclose(found.times, trace.times[: len(found)] - trace.times[0], atol=1e-9)
        assert short.rho(found, test) == pytest.approx(short.rho(trace, test), abs=0.02)
    (note,) = notes(short, Used(read, 8, False, 3, 8), ENOUGH)
    assert "8 of 8 real rollouts" in note
    assert "0.01 s" in note


def test_recordings_as_fine_as_the_simulators_are_not_changed():
    runs = many(8, 8)
    same = real_rollouts(BENCH, runs, None, 0)[0][1]
    np.testing.assert_array_equal(same["v"], runs[0][1]["v"])
    assert dict(same.meta) == dict(runs[0][1].meta)


def test_between_its_samples_a_flag_is_what_it_was():
    own = np.array([0.0, 0.1, 0.25, 0.4])
    trace = Trace(own + 3.0, {"x": 2.0 * own, "on": np.array([0.0, 1.0, 0.0, 1.0])}, {"x": "m"})
    two = Trace(own, {"q": np.stack([own, -own], axis=1)})
    np.testing.assert_allclose(read_at(two, 0.2)["q"], [[0.0, 0.0], [0.2, -0.2], [0.4, -0.4]])
    found = read_at(trace, 0.05)
    np.testing.assert_allclose(found.times, 0.05 * np.arange(9))
    np.testing.assert_allclose(found["x"], 0.1 * np.arange(9), atol=1e-12)
    np.testing.assert_array_equal(found["on"], [0, 0, 1, 1, 1, 0, 0, 0, 1])
    # What ends within its own last period before the horizon keeps its last values; what ends sooner does not.
    np.testing.assert_allclose(read_at(trace, 0.05, 0.5)["x"][-3:], 0.8)
    assert read_at(trace, 0.05, 0.6).duration == pytest.approx(0.4)


def test_a_rollout_that_rho_cannot_be_told_of_is_named():
    runs = many(8, 8)
    test, trace = runs[3]
    kept = {name: values for name, values in trace.channels.items() if name != "v"}
    runs[3] = (test, Trace(trace.times, kept, {n: unit for n, unit in trace.units.items() if n in kept}))
    with pytest.raises(UsageError, match=r"^real rollout 3: the trace has no channel 'v'"):
        real_rollouts(BENCH, runs, None, 0)


def flipped(trace):
    channels = dict(trace.channels) | {"u": -trace["u"]}
    return Trace(trace.times, channels, trace.units)


def test_a_channel_with_the_other_sign_is_told():
    odd = misread(BENCH, many(8, 8, flipped))
    assert list(odd) == ["u"]
    assert "sign" in odd["u"]
    assert misread(BENCH, many(8, 8)) == {}


@pytest.mark.slow
def test_a_channel_with_the_other_sign_comes_first(cache):
    odd = misread(BENCH, many(8, 8, flipped))
    found = s2r.diagnose(s2r.parse_spec(SPEC), Cart(), many(12, 9, flipped), cache=cache, where=False)
    assert found.misread == ("u",)
    assert found.notes[0].startswith(odd["u"])
    assert " u " in next_step(found, s2r.parse_spec(SPEC))


@pytest.mark.parametrize(
    ("times", "words"),
    [
        (-1.0, "sign"),
        (1e3, "about 1000 times"),
    ],
)
def test_a_cause_that_moves_a_command_hides_neither_its_sign_nor_its_unit(times, words):
    def spoilt(trace):
        return Trace(trace.times, dict(trace.channels) | {"u": times * trace["u"]}, {})

    rng = np.random.default_rng(6)
    tests = [{"vd": rng.uniform(0.2, 1), "acc": rng.uniform(1, 4)} for _ in range(8)]
    weak = [(test, real(test, 900 + i, {"motor": 0.7})) for i, test in enumerate(tests)]
    assert misread(BENCH, weak) == {}
    suspects = misread(BENCH, [(test, spoilt(trace)) for test, trace in weak])
    assert list(suspects) == ["u"]
    assert words in suspects["u"]


@pytest.mark.parametrize("how", ["raises", "falls"])
def test_a_simulator_that_all_effects_at_once_break_has_no_commands(how):
    class Frail(Cart):
        def rollout(self, params, seed):
            if len(self.added) > 3 and how == "raises":
                raise RuntimeError("too much")
            trace = super().rollout(params, seed)
            if len(self.added) <= 3:
                return trace
            first = {n: x[:5] for n, x in trace.channels.items()}
            return Trace(trace.times[:5], first, trace.units, {"failure": "stopped"})

    bench = Bench.of(s2r.parse_spec(SPEC), "tracking", Frail())
    assert misread(bench, many(8, 8), lines(Cart().effects())) == {}


def test_a_channel_that_never_moves_is_told():
    def dead(trace):
        return Trace(trace.times, dict(trace.channels) | {"v_meas": 0.0 * trace["v"]}, trace.units)

    [finding] = direct(BENCH, many(8, 8, dead))
    assert (finding.code, finding.channel) == ("still", "v_meas")
    assert finding.text.startswith("v_meas ")


@pytest.mark.parametrize(
    ("every", "words"),
    [(3, "in 4 of 12 real rollouts, and is not used there"),
     (1, "in 12 of 12 real rollouts, and is not used at all")],
)  # fmt: skip
def test_a_channel_that_some_rollouts_lack_or_have_gaps_in_is_told(every, words):
    runs = many(12, 9)
    for i in range(0, 12, every):
        test, trace = runs[i]
        channels = dict(trace.channels)
        if i % 2:
            del channels["u"]
        else:
            channels["u"] = np.where(np.arange(len(trace)) < 9, np.nan, trace["u"])
        runs[i] = (
            test,
            Trace(trace.times, channels, {n: u for n, u in trace.units.items() if n in channels}),
        )
    [one] = notes(BENCH, Used(runs, 12, False, 4, 12), ENOUGH)
    assert one.startswith("u is missing")
    assert one.endswith(words)


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0.2, "0.2 s too early"), (0.03, "0.03 s too early"), (-0.3, "0.3 s too late")],
)
def test_a_recording_that_begins_at_another_time_is_known_by_a_command(seconds, words):
    """No effect changes the speed that is asked for; where it comes later, the recording began earlier."""
    found = lines(Cart().effects())
    delayed = [(test, real(test, 40 + i, {"delay": 0.06})) for i, (test, _) in enumerate(many(8, 8))]
    assert misread(BENCH, delayed, found) == {}

    def shifted(trace):
        k = round(seconds / 0.01)
        moved = {n: np.roll(x, k) for n, x in trace.channels.items()}
        for x in moved.values():  # before it stands still, and after it is not known
            x[: max(k, 0)] = x[max(k, 0)]
            x[len(x) + min(k, 0) :] = x[len(x) + min(k, 0) - 1]
        return Trace(trace.times, moved, trace.units)

    suspects = misread(BENCH, [(test, shifted(trace)) for test, trace in delayed], found)
    assert list(suspects) == ["v_ref"]
    assert words in suspects["v_ref"]


def test_times_that_are_no_seconds_get_one_sentence():
    def in_ms(trace):
        return Trace(1e3 * trace.times, dict(trace.channels), trace.units)

    with pytest.raises(UsageError, match=r"real rollout 0 lasts 1990 s, .* in ms\b"):
        real_rollouts(BENCH, many(8, 8, in_ms), None, 0)


def test_a_long_recording_at_the_simulators_rate_is_not_in_ms():
    def repeated(trace):
        channels = {name: np.tile(values, 150) for name, values in trace.channels.items()}
        return Trace(0.01 * np.arange(150 * len(trace)), channels, trace.units)

    assert len(real_rollouts(BENCH, many(8, 8, repeated), None, 0)) == 8


def test_an_angle_that_is_kept_within_a_turn_is_told():
    angle = Channel("v", "rad", "heading")
    plain = Cart().rollout(TEST, 0)
    turned = 4.0 * np.cumsum(plain["v"]) * 0.1
    goes_on = Trace(plain.times, dict(plain.channels) | {"v": turned}, plain.units)
    wrapped = Trace(
        plain.times, dict(plain.channels) | {"v": (turned + np.pi) % (2 * np.pi) - np.pi}, plain.units
    )
    words = jumping(angle, [wrapped, goes_on], [(goes_on, wrapped)])
    assert words.startswith("v jumps")
    assert "in 1 of 2 real rollouts" in words
    assert jumping(angle, [goes_on], [(goes_on, goes_on)]) == ""
    assert jumping(angle, [wrapped], [(wrapped, wrapped)]) == ""  # of both it does
    assert jumping(replace(angle, unit="m/s"), [wrapped], [(goes_on, wrapped)]) == ""


def test_one_rollout_in_another_unit_is_told_with_its_number():
    runs = many(8, 8)
    test, trace = runs[6]
    runs[6] = (test, Trace(trace.times, dict(trace.channels) | {"u": 1e3 * trace["u"]}, trace.units))
    [finding] = direct(BENCH, runs)
    assert (finding.code, finding.channel) == ("unit of one", "u")
    for words in ("u of real rollout 6 (vd = 0.8, acc = 2)", "1000 times", " V "):
        assert words in finding.text


def test_one_recording_of_two_tests_is_told_and_one_of_a_test_that_was_run_twice_is_not():
    runs = many(8, 8)
    copied = [*runs[:7], (runs[7][0], runs[2][1])]
    suspicion = misread(BENCH, copied)["the tests"]
    assert suspicion.startswith("real rollout 7 (vd = 0.9, acc = 2) ")
    assert "real rollout 2 (vd = 0.4, acc = 2)" in suspicion
    assert misread(BENCH, [*runs, runs[2]]) == {}

    class Bare(Cart):  # a simulator to which these tests are one
        def rollout(self, params, seed):
            return super().rollout(dict(params) | {"vd": 0.5, "acc": 2.0}, seed)

    one = [(test, Bare().rollout(test, 0)) for test, _ in runs]
    assert misread(Bench.of(s2r.parse_spec(SPEC), "tracking", Bare()), one) == {}


def test_a_channel_of_another_name_is_told_beside_the_one_that_lacks():
    def renamed(trace):
        channels = dict(trace.channels)
        channels["V_meas"] = channels.pop("v_meas")
        return Trace(trace.times, channels, {n: u for n, u in trace.units.items() if n in channels})

    [one] = notes(BENCH, Used(many(12, 9, renamed), 12, False, 4, 12), ENOUGH)
    assert one.startswith("the real rollouts have no v_meas.")
    assert " V_meas" in one


def test_a_name_that_stands_for_two_effects_gets_one_sentence():
    class Twice(Cart):
        def effects(self):
            return (*super().effects(), super().effects()[0])

    with pytest.raises(BackendError, match=r"two effects .*'viscous'"):
        Bench.of(s2r.parse_spec(SPEC), "tracking", Twice())


def test_a_parameter_that_varies_and_that_the_spec_does_not_know_gets_one_sentence(tmp_path):
    rows = ["id,vd,acc,operator"]
    for i in range(8):
        test = {"vd": 0.2 + 0.1 * i, "acc": 2.0 + 0.1 * i}
        logs.write(real(test, i, {}), tmp_path / f"r{i}.npz")
        rows.append(f"r{i},{test['vd']},{test['acc']},{i}")
    (tmp_path / "rollouts.csv").write_text("\n".join(rows) + "\n")
    # What the simulator does not have is nobody's business.
    assert len(real_rollouts(BENCH, f"log:{tmp_path}", None, 0)) == 8
    of_one = s2r.parse_spec(SPEC.replace("param  acc {m/s^2} in [1, 4]\n", ""))
    with pytest.raises(UsageError, match=r"'acc' from 2 to 2\.7.* does not declare"):
        real_rollouts(Bench.of(of_one, "tracking", Cart()), f"log:{tmp_path}", None, 0)
    # Of what is left out, for the spec keeps to another value, nothing is asked.
    of_one = s2r.parse_spec(SPEC.replace("acc {m/s^2} in [1, 4]", "acc {m/s^2} = 2"))
    with pytest.raises(UsageError, match=r"^1 real rollouts"):
        real_rollouts(Bench.of(of_one, "tracking", Cart()), f"log:{tmp_path}", None, 0)


@pytest.mark.slow
def test_an_effect_that_is_in_the_simulator_is_what_nominal_is(quick):
    patched = Cart().with_effects({"coulomb": {"force": 1.5}})
    known = {effect.name: effect.parameters[0].nominal for effect in catalogue_of(patched)}
    assert known["coulomb"] == 1.5
    assert known["viscous"] == 0.0
    rng = np.random.default_rng(5)
    tests = [{"vd": rng.uniform(0.2, 1), "acc": rng.uniform(1, 4)} for _ in range(30)]
    runs = [(test, real(test, 700 + i, {})) for i, test in enumerate(tests)]
    found = s2r.diagnose(s2r.parse_spec(SPEC), patched, runs, cache=quick, where=False)
    # It is the machine that has less friction than the simulator was given.
    assert found.which.answer == ("coulomb",), found.which.ranked[:3]
    assert found.patch["coulomb"]["force"] < 0.4
    assert found.how_far.share[0] > 0.8


@pytest.mark.parametrize(("low", "high"), [(0.1, 0.8), (-2.0, -1.0), (0.0, 0.0), (0.0, float("inf"))])
def test_a_range_without_the_nominal_value_gets_one_sentence(low, high):
    class Odd(Cart):
        def effects(self):
            first, *rest = super().effects()
            parameter = replace(first.parameters[0], low=low, high=high)
            return (replace(first, parameters=(parameter,)), *rest)

    with pytest.raises(
        BackendError, match=r"'viscous' has 'coefficient' in \[.*\] with the nominal value 0\b"
    ):
        catalogue_of(Odd())


@pytest.mark.parametrize(
    ("prior", "typical"),
    [
        ("half-normal, 1 N*s/m", 0.5),
        ("half-normal, 9 N*s/m", 1.0),  # no more than the range holds
        ("Half-Normal, .5 N*s/m", 0.25),
        ("uniform", 2 / 3),
        ("uniform, as normally mounted", 2 / 3),
        ("half normal 1 N*s/m", None),
        ("normal, standard deviation of 1", None),
        ("half-normal, 0", None),
        ("half-normal, 20 mN*s/m", None),  # in another unit
    ],
)
def test_a_prior_that_should_have_a_scale_and_has_none_gets_one_sentence(prior, typical):
    class Odd(Cart):
        def effects(self):
            first, *rest = super().effects()
            parameter = replace(first.parameters[0], prior=prior)
            return (replace(first, parameters=(parameter,)), *rest)

    if typical is None:
        with pytest.raises(BackendError, match=r"'viscous' has 'coefficient' with the prior '.*scale"):
            catalogue_of(Odd())
    else:
        first = catalogue_of(Odd())[0]
        assert line(first, first.parameters[0]).typical == pytest.approx(4.0 * typical)


@pytest.fixture(scope="module")
def bank(cache):
    return banks.bank(BENCH, cache=Cache(cache))


def test_a_test_that_was_run_is_not_asked_for_again(bank):
    bench, signatures = replace(BENCH, features=bank.features), Signatures.of(bank)
    rivals = [("payload", {"payload": {"mass": 1.0}}), ("viscous", {"viscous": {"coefficient": 4.0}})]
    first = next_test(bench, signatures, rivals, [], protocols=False)
    again = next_test(bench, signatures, rivals, [first.params], protocols=False)
    assert again.params != first.params
    assert again.sigma <= first.sigma
    assert next_test(bench, signatures, rivals, bank.tests, protocols=False) is None


def test_no_test_is_said_to_tell_apart_what_laws_a_little_off_would_make_the_same(bank):
    bench, signatures = replace(BENCH, features=bank.features), Signatures.of(bank)

    def rivals(more):
        return [("payload", {"payload": {"mass": 1.0}}), ("more", {"payload": {"mass": 1.0 + more}})]

    assert next_test(bench, signatures, rivals(0.2), [], protocols=False) is None
    assert next_test(bench, signatures, rivals(1.0), [], protocols=False) is None  # it is only fitted larger
    both = [*rivals(0.0)[:1], ("coulomb", {"coulomb": {"force": 1.0}})]
    plain = next_test(bench, signatures, both, [], protocols=False)
    assert plain.separates == ("payload", "coulomb")
    # What the diagnosis would not believe is not promised.
    warm = next_test(bench, signatures, both, [], protocols=False, temperature=4.0)
    assert warm is None or warm.sigma == pytest.approx(plain.sigma / 2.0)


class Uneven(Cart):
    """A rail that leans one way or the other, by how a rollout begins."""

    def rollout(self, params, seed):
        sign = np.random.default_rng([seed, 7]).choice([-1.0, 1.0])
        added = tuple((name, sign * value if name == "tilt" else value) for name, value in self.added)
        return Cart.rollout(replace(self, added=added), params, seed)


def test_what_an_effect_does_on_average_is_not_one_draw_of_it():
    bank = banks.simulate(Bench.of(s2r.parse_spec(SPEC), "tracking", Uneven()))
    lean = next(
        change for line, change in zip(bank.lines, bank.changes, strict=True) if line.effect == "tilt"
    )
    moved = np.nanmax(np.abs(lean), axis=(0, 1))
    column = int(np.nanargmax(np.abs(lean / np.where(moved > 0, moved, 1.0)).mean(axis=(0, 1))))
    assert {-1.0, 1.0} <= set(np.sign(lean[-1, :, column]).tolist())
    assert np.ptp(lean[-1, :, column]) > 0.5 * moved[column]


def test_a_test_that_ends_early_every_time_is_told_to_be_no_accident():
    runs = many(12, 4)
    first = runs[0][0]
    again = [(t, replace(r, meta=dict(r.meta) | {"failure": "fall"}) if t == first else r) for t, r in runs]
    [falls] = [n for n in notes(BENCH, Used(again, 12, True, 0, 12), ENOUGH) if "ended early" in n]
    assert "(fall, every time at one test" in falls


def test_a_prior_that_makes_every_gap_a_little_of_everything_is_told():
    """A scale of 20 s for a lag made a gap of eleven times the scatter not material, and nothing said why."""

    def curve(effect, rho):
        of = next(one for one in lines(Cart().effects()) if one.effect == effect)
        return Curve(of, np.array([0.25, 1.0]), np.zeros((2, 3, 1)), np.array([[0.25 * rho] * 3, [rho] * 3]))

    usual = [curve("viscous", 0.3), curve("coulomb", 0.2), curve("tilt", 0.1)]
    assert mostly_of_one(usual) == ""
    assert mostly_of_one([*usual, curve("payload", 30.0)]) == "payload"
    assert mostly_of_one(usual[:1]) == ""  # there is no other

    tests = [{"v": k / 9} for k in range(9)]
    far = how_far(np.ones(9), np.zeros(9), None, np.ones(9), tests, 0.05, 3.0, 3, "m")
    assert not far.material
    [payload] = [effect for effect in Cart().effects() if effect.name == "payload"]
    words = hidden_by_one(payload, far)
    for figure in (
        "gap of 1 m ",
        f" {1.0 / far.floor:.0f} times",
        " 3 m",
        "payload",
        "(mass: half-normal, 0.7 kg)",
    ):
        assert figure in words
    assert " times" not in hidden_by_one(payload, replace(far, floor=0.0))
