"""What recordings are in the simulator's terms, and what is said of what they lack."""

from dataclasses import replace

import numpy as np
import pytest
from s2r_cart import SPEC, Cart, Machine, real

import s2r_spec as s2r
from s2r_spec import logs
from s2r_spec.backend import Channel
from s2r_spec.diagnose.data.rollouts import RealRollouts, convert_units, recorded_rollouts, truncate
from s2r_spec.diagnose.data.split import ENOUGH, TrainHeldOut
from s2r_spec.diagnose.notes import notes
from s2r_spec.diagnose.quality import findings
from s2r_spec.diagnose.quality.channels import find_wrapped as jumping
from s2r_spec.diagnose.quality.recordings import Recordings
from s2r_spec.diagnose.simulator.axes import effect_axes, effect_axis
from s2r_spec.diagnose.simulator.bench import Bench
from s2r_spec.effects import catalogue_of
from s2r_spec.errors import BackendError, TraceError, UsageError
from s2r_spec.report.advice import next_step
from s2r_spec.trace import Trace
from tests.diagnose.toy import Toy
from tests.errors import states

TEST = {"vd": 0.8, "acc": 3.0}
BENCH = Bench.of(s2r.parse_spec(SPEC), "tracking", Cart())


def misread(bench, runs, found=()):
    """Return channel → what is said of it."""
    return {each.channel: each.text for each in findings(bench, runs, found)}


def used(runs, train=None, held_out=4):
    """Return rollouts as all that a diagnosis has, and in two parts; so many of them are used."""
    some = tuple(runs[: len(runs) if train is None else train])
    return runs, TrainHeldOut(RealRollouts(some[held_out:]), some[:held_out])


def changed(**changes):
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


def test_that_recordings_are_longer_is_told():
    tests = many(8, 8)
    longer = [(test, truncate(trace, Cart().duration / 2)) for test, trace in tests]
    [note] = notes(BENCH, *used(longer))
    assert note.startswith("8 of 8 real rollouts")
    assert f" {Cart().duration / 2:g} s " in note


@pytest.mark.parametrize(("unit", "words"), [("A", ("in A,", " V ", "'cart'")), ("volts!", ("'volts!'",))])
def test_a_unit_that_does_not_convert_gets_one_sentence(unit, words):
    trace = changed(u=(Cart().rollout(TEST, 0)["u"], unit))
    with pytest.raises(UsageError, match="'u'") as raised:
        convert_units(trace, Cart())
    for word in words:
        assert word in str(raised.value)


def test_declared_units_do_not_change_the_diagnosis(cache):
    spec = s2r.parse_spec(
        "param v in [0, 1]\nsignal x {N}\nrequire small: always[0, 0.9 s] (abs(x) <= 2 {N})"
    )
    machine = Toy((("c", 1.6), ("a", 0.2)))
    runs = [({"v": k / 11}, machine.rollout({"v": k / 11}, k)) for k in range(12)]
    runs += [({}, machine.run("show", {}, 50 + k)) for k in range(3)]

    def in_other_units(trace):
        return replace(trace, channels={"x": 1000.0 * trace["x"]}, units={"x": "mN"})

    plain, other = (
        s2r.diagnose(spec, Toy(), some, cache=cache, where=False)
        for some in (runs, [(test, in_other_units(trace)) for test, trace in runs])
    )
    assert plain.which.answer == other.which.answer == ("c",)
    assert other.which.membership == pytest.approx(plain.which.membership, abs=1e-4)
    for one, two in zip(plain.which.effects, other.which.effects, strict=True):
        assert two.largest.value == pytest.approx(one.largest.value, abs=1e-4)


def test_nothing_is_said_of_rollouts_that_lack_nothing():
    assert notes(BENCH, *used(many(30, ENOUGH[0]))) == ()


def fallen(trace):
    return replace(trace, meta=dict(trace.meta) | {"failure": "fall"})


def test_falls_missing_channels_and_few_tests_are_told():
    def bare(trace):
        rest = {n: x for n, x in trace.channels.items() if n != "v_meas"} | {"u": np.full(len(trace), np.nan)}
        return Trace(trace.times, rest, {n: trace.units[n] for n in rest})

    some = [(test, fallen(trace) if i < 4 else trace) for i, (test, trace) in enumerate(many(10, 5, bare))]
    texts = notes(BENCH, *used(some, held_out=0))
    assert texts[0].startswith("4 of 10 real rollouts ended early (fall)")
    assert texts[1].startswith("the real rollouts have no v_meas, u")
    assert states(texts[2], "12 rollouts of 9 different tests", "10 of 5")
    text = SPEC.replace("in [1, 4]", "= 2").replace("in [0.2, 1]", "= 0.5").partition("certify")[0]
    none = Bench.of(s2r.parse_spec(text), "tracking", Cart())
    [few] = notes(none, *used([({}, trace) for _, trace in many(8, 1)], held_out=0))
    assert states(few, "9 rollouts", " 8")
    every = [(test, fallen(trace)) for test, trace in some]
    assert notes(BENCH, *used(every))[0].startswith("10 of 10 real rollouts ended early")
    first = notes(BENCH, *used(some[3:], 6))[0]
    assert states(first, "1 of 7 real rollouts ended early (fall)", "left out")
    [one] = notes(BENCH, *used(many(12, 1)))
    assert one.startswith("all real rollouts repeat one test")
    [alone] = notes(BENCH, *used([], held_out=0))
    assert states(alone, "no test", "ρ")


@pytest.mark.parametrize(("times", "words"), [(1e3, "about 1000 times"), (np.pi / 180.0, "about a 57th of")])
def test_a_channel_in_a_unit_that_was_not_said_is_told(times, words):
    def spoilt(trace):
        units = {name: unit for name, unit in trace.units.items() if name != "v_meas"}
        return Trace(
            trace.times, dict(trace.channels) | {"v_meas": times * trace["v_meas"]}, units, trace.meta
        )

    odd = findings(BENCH, many(12, 9, spoilt))
    [one] = notes(BENCH, *used(many(12, 9, spoilt)), odd=odd)
    assert one.startswith(f"v_meas of the real rollouts is {words} ")
    assert " m/s" in one


class Blind(Cart):
    """A cart whose residuals need a channel that its own rollouts have, and no recording has."""

    def rollout(self, params, seed):
        trace = super().rollout(params, seed)
        return Trace(trace.times, trace.channels, trace.units, dict(trace.meta) | {"own": True})

    def residuals(self, trace, params):
        if "own" in trace.meta:
            return trace
        raise TraceError("the channel 'nothing' is missing")


def test_that_the_equations_could_not_be_asked_is_told():
    bench = Bench.of(s2r.parse_spec(SPEC), "tracking", Blind())
    [one] = notes(bench, *used(many(12, 9)))
    assert "(the channel 'nothing' is missing)" in one


def test_what_changes_nothing_is_told():
    [one] = notes(BENCH, *used(many(12, 9)), ("paint", "name"))
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
        recorded_rollouts(bench, s2r.load_backend(f"log:{tmp_path}"))


def slower(trace, step):
    """Return the trace as a logger would have it that keeps a sample now and then."""
    every = round(step / (trace.times[1] - trace.times[0]))
    return Trace(trace.times[::every], {n: x[::every] for n, x in trace.channels.items()}, trace.units)


def test_recordings_whose_samples_miss_an_end_of_a_window_are_used_as_they_are():
    runs = many(8, 8)
    slow = [(test, slower(trace, 0.03)) for test, trace in runs]
    read = recorded_rollouts(BENCH, slow).tests
    for (test, found), (_, before), (_, trace) in zip(read, slow, runs, strict=True):
        np.testing.assert_array_equal(np.diff(found.times), np.diff(before.times))
        assert BENCH.rho(found, test) == pytest.approx(BENCH.rho(trace, test), abs=0.02)
    assert notes(BENCH, *used(read)) == ()


def test_where_a_window_is_shorter_than_the_time_between_samples_the_simulators_are_read():
    short = Bench.of(s2r.parse_spec(SPEC.replace("[0, 1.99 s]", "[1.98 s, 1.99 s]")), "tracking", Cart())
    runs = many(8, 8)
    read = recorded_rollouts(short, [(test, slower(trace, 0.03)) for test, trace in runs]).tests
    for (test, found), (_, trace) in zip(read, runs, strict=True):
        np.testing.assert_allclose(found.times, trace.times[: len(found)] - trace.times[0], atol=1e-9)
        assert short.rho(found, test) == pytest.approx(short.rho(trace, test), abs=0.02)
    (note,) = notes(short, *used(read))
    assert "8 of 8 real rollouts" in note
    assert "0.01 s" in note


def test_recordings_as_fine_as_the_simulators_are_not_changed():
    runs = many(8, 8)
    same = recorded_rollouts(BENCH, runs).tests[0][1]
    np.testing.assert_array_equal(same["v"], runs[0][1]["v"])
    assert dict(same.meta) == dict(runs[0][1].meta)


def test_a_rollout_that_rho_cannot_be_told_of_is_named():
    runs = many(8, 8)
    test, trace = runs[3]
    kept = {name: values for name, values in trace.channels.items() if name != "v"}
    runs[3] = (test, Trace(trace.times, kept, {n: unit for n, unit in trace.units.items() if n in kept}))
    with pytest.raises(UsageError, match=r"^real rollout 3: the trace has no channel 'v'"):
        recorded_rollouts(BENCH, runs)


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
    assert misread(bench, many(8, 8), effect_axes(Cart().effects())) == {}


def test_a_channel_that_never_moves_is_told():
    def dead(trace):
        return Trace(trace.times, dict(trace.channels) | {"v_meas": 0.0 * trace["v"]}, trace.units)

    [finding] = findings(BENCH, many(8, 8, dead))
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
    [one] = notes(BENCH, *used(runs))
    assert one.startswith("u is missing")
    assert one.endswith(words)


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0.2, "0.2 s too early"), (0.03, "0.03 s too early"), (-0.3, "0.3 s too late")],
)
def test_a_recording_that_begins_at_another_time_is_known_by_a_command(seconds, words):
    """No effect changes the speed that is asked for; where it comes later, the recording began earlier."""
    found = effect_axes(Cart().effects())
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
    assert list(suspects) == ["the clock"]
    assert words in suspects["the clock"]


def test_times_that_are_no_seconds_get_one_sentence():
    def in_ms(trace):
        return Trace(1e3 * trace.times, dict(trace.channels), trace.units)

    with pytest.raises(UsageError, match=r"real rollout 0 lasts 1990 s, .* in ms\b"):
        recorded_rollouts(BENCH, many(8, 8, in_ms))


def test_a_long_recording_at_the_simulators_rate_is_not_in_ms():
    def repeated(trace):
        channels = {name: np.tile(values, 150) for name, values in trace.channels.items()}
        return Trace(0.01 * np.arange(150 * len(trace)), channels, trace.units)

    assert len(recorded_rollouts(BENCH, many(8, 8, repeated)).tests) == 8


def test_an_angle_that_is_kept_within_a_turn_is_told():
    angle = Channel("v", "rad", "heading")
    plain = Cart().rollout(TEST, 0)
    turned = 4.0 * np.cumsum(plain["v"]) * 0.1
    goes_on = Trace(plain.times, dict(plain.channels) | {"v": turned}, plain.units)
    wrapped = Trace(
        plain.times, dict(plain.channels) | {"v": (turned + np.pi) % (2 * np.pi) - np.pi}, plain.units
    )

    def said(channel, real, simulated):
        class Fixed(Cart):
            def rollout(self, params, seed):
                return simulated

        bench = Bench.of(s2r.parse_spec(SPEC), "tracking", Fixed())
        found = jumping(channel, Recordings(bench, [(TEST, trace) for trace in real]))
        return "" if found is None else found.text

    words = said(angle, [wrapped, goes_on], goes_on)
    assert words.startswith("v jumps")
    assert "in 1 of 2 real rollouts" in words
    assert said(angle, [goes_on], goes_on) == ""
    assert said(angle, [wrapped], wrapped) == ""  # of both it does
    assert said(replace(angle, unit="m/s"), [wrapped], goes_on) == ""


def test_one_rollout_in_another_unit_is_told_with_its_number():
    runs = many(8, 8)
    test, trace = runs[6]
    runs[6] = (test, Trace(trace.times, dict(trace.channels) | {"u": 1e3 * trace["u"]}, trace.units))
    [finding] = findings(BENCH, runs)
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

    [one] = notes(BENCH, *used(many(12, 9, renamed)))
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
    assert len(recorded_rollouts(BENCH, s2r.load_backend(f"log:{tmp_path}")).tests) == 8
    of_one = s2r.parse_spec(SPEC.replace("param  acc {m/s^2} in [1, 4]\n", ""))
    with pytest.raises(UsageError, match=r"'acc' from 2 to 2\.7.* does not declare"):
        recorded_rollouts(Bench.of(of_one, "tracking", Cart()), s2r.load_backend(f"log:{tmp_path}"))
    # Of what is left out, for the spec keeps to another value, nothing is asked.
    of_one = s2r.parse_spec(SPEC.replace("acc {m/s^2} in [1, 4]", "acc {m/s^2} = 2"))
    with pytest.raises(UsageError, match=r"^1 real rollouts"):
        recorded_rollouts(Bench.of(of_one, "tracking", Cart()), s2r.load_backend(f"log:{tmp_path}"))


@pytest.mark.slow
def test_an_effect_that_is_in_the_simulator_is_what_nominal_is(cache):
    patched = Cart().with_effects({"coulomb": {"force": 1.5}})
    known = {effect.name: effect.parameters[0].nominal for effect in catalogue_of(patched)}
    assert known["coulomb"] == 1.5
    assert known["viscous"] == 0.0
    found = s2r.diagnose(s2r.parse_spec(SPEC), patched, Machine(), 16, cache=cache, where=False)
    # It is the machine that has less friction than the simulator was given.
    assert found.which.answer == ("coulomb",), found.which.ranked[:3]
    assert found.patch["coulomb"]["force"] < 0.4
    assert found.how_far.share.estimate > 0.8


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
        assert effect_axis(first, first.parameters[0]).typical == pytest.approx(4.0 * typical)


def test_a_test_that_ends_early_every_time_is_told_to_be_no_accident():
    runs = many(12, 4)
    first = runs[0][0]
    again = [(t, replace(r, meta=dict(r.meta) | {"failure": "fall"}) if t == first else r) for t, r in runs]
    [falls] = [n for n in notes(BENCH, *used(again)) if "ended early" in n]
    assert "(fall, every time at one test" in falls
