"""The cart's gap: named causes, none, several, and one that the catalogue lacks."""

import json
import re
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from s2r_cart import EFFECTS, SPEC, VOLTAGE, Cart, real

import s2r_spec as s2r
from s2r_spec.backend import Effect, EffectParameter
from s2r_spec.diagnose.diagnosis import Verdict
from s2r_spec.diagnose.models import Simulator
from s2r_spec.diagnose.parted import exchanged, split
from s2r_spec.diagnose.remainder import Remainder
from s2r_spec.errors import UsageError
from s2r_spec.trace import Trace
from tests.errors import states

pytestmark = pytest.mark.filterwarnings("ignore::sklearn.exceptions.ConvergenceWarning")


def rollouts(effects, case, n=30, extra=None):
    rng = np.random.default_rng(case)
    tests = [{"vd": rng.uniform(0.2, 1), "acc": rng.uniform(1, 4)} for _ in range(n)]
    return [(test, real(test, 1000 * case + i, effects, extra=extra)) for i, test in enumerate(tests)]


@pytest.fixture(scope="module")
def find(cache):
    """Diagnose the cart; where is asked for by those alone who say so, for it takes half of the time."""
    spec = s2r.parse_spec(SPEC)

    def diagnosed(effects, case, extra=None, where=False, n=30, **more):
        runs = rollouts(effects, case, n, extra)
        return s2r.diagnose(spec, Cart(), runs, cache=cache, where=where, **more)

    return diagnosed


@pytest.fixture(scope="module")
def rubbing(find):
    """The answer to a machine with dry friction."""
    return find({"coulomb": 1.5}, case=11, n=16)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("coulomb", 1.5),
        pytest.param("delay", 0.04, marks=pytest.mark.slow),
        pytest.param("speed_scale", 0.85, marks=pytest.mark.slow),
        pytest.param("viscous", 2.0, marks=pytest.mark.slow),
        pytest.param("tilt", -1.4, marks=pytest.mark.slow),
    ],
)
def test_an_effect_is_named_sized_and_closes_the_gap(find, rubbing, name, value):
    found = rubbing if name == "coulomb" else find({name: value}, case=11)
    assert found.which.ranked[0][0] == (name,), found.reason
    assert found.verdict in (Verdict.NAMED, Verdict.CONFOUNDED)
    estimate = found.which.estimates[0]
    assert estimate.effect == name
    nominal = {"speed_scale": 1.0}.get(name, 0.0)
    assert abs(estimate.value - value) < 0.35 * abs(value - nominal)
    assert found.how_far.after.mean < found.how_far.before.mean
    assert found.patch[name]
    assert name in found.tuned
    assert found.how_far.tuned.mean < found.how_far.before.mean


@pytest.mark.slow
@pytest.mark.parametrize(
    "effects",
    [
        {"coulomb": 1.5, "viscous": 2.0, "tilt": -1.4, "speed_scale": 0.85},
        {"coulomb": 1.5, "tilt": 1.4, "delay": 0.04, "speed_scale": 1.15},
    ],
)
def test_a_machine_with_four_effects_has_all_four_named(find, effects):
    found = find(effects, case=11)
    assert found.verdict in (Verdict.NAMED, Verdict.CONFOUNDED), found.reason
    assert set(found.which.answer) == set(effects)
    (named,) = [names for names in found.which.several if set(names) == set(effects)]
    assert found.which.ranked[0][0] == named
    assert all(found.which.membership[name] > 0.8 for name in effects)
    assert list(named) in [one["effects"] for one in found.to_json()["which"]["pairs"]]
    assert found.how_far.share[0] > 0.8


@pytest.mark.parametrize("effects", [{"payload": 1.2}, pytest.param({"motor": 0.8}, marks=pytest.mark.slow)])
def test_effects_of_one_kind_are_answered_as_a_set_however_clear_the_data_are(find, effects):
    found = find(effects, case=5, n=16)
    assert ("payload", "motor") in found.which.isolability.kinds(("payload", "motor", "delay"))
    assert found.verdict is Verdict.CONFOUNDED
    assert set(found.which.confounded) == {"payload", "motor"}
    first, second = (found.which.singles[name] for name in ("payload", "motor"))
    assert first + second > 0.8
    assert max(first, second) < 2.0 * min(first, second)
    assert found.how_far.after.mean < found.how_far.before.mean


def failed(rollouts, chosen):
    """Return the rollouts, some of them cut short by a fall."""

    def cut(trace, k):
        last = len(trace) * (3 + k % 5) // 10
        channels = {name: values[:last] for name, values in trace.channels.items()}
        return Trace(trace.times[:last], channels, trace.units, dict(trace.meta) | {"failure": "fall"})

    return [(test, cut(t, k) if k in chosen else t) for k, (test, t) in enumerate(rollouts)]


@pytest.mark.slow
@pytest.mark.parametrize("case", [2, 3])
def test_a_fall_or_three_of_thirty_change_nothing_that_is_said_of_the_others(cache, case):
    spec, runs = s2r.parse_spec(SPEC), rollouts({"coulomb": 1.2}, 11)
    fallen = {2: [4], 3: [0, 9, 17]}[case]
    found = s2r.diagnose(spec, Cart(), failed(runs, fallen), cache=cache, where=case == 3)
    without = [run for k, run in enumerate(runs) if k not in fallen]
    alone = s2r.diagnose(spec, Cart(), without, cache=cache, where=case == 3)
    assert f"{len(fallen)} of 30 real rollouts ended early (fall)" in found.notes[0]
    assert found.verdict is Verdict.NAMED
    assert found.to_json() | {"notes": []} == alone.to_json() | {"notes": []}


@pytest.mark.slow
def test_where_many_fall_the_cause_is_that_of_the_others_and_the_gap_that_of_all(cache):
    spec, runs = s2r.parse_spec(SPEC), rollouts({"coulomb": 1.2}, 11)
    found = s2r.diagnose(spec, Cart(), failed(runs, range(0, 30, 3)), cache=cache, where=False)
    assert states(found.notes[0], "10 of 30", "fall")
    assert found.which.membership["coulomb"] > 0.9 * (1.0 - found.which.unknown)
    # A fall counts as −1, and no effect of the catalogue makes one.
    assert found.how_far.before.mean > 0.1
    assert found.how_far.floor < 0.05
    assert found.verdict is Verdict.UNKNOWN


class Painted(Cart):
    """A cart one of whose effects does nothing."""

    def effects(self):
        (colour,) = EFFECTS[0].parameters
        return (
            *super().effects(),
            replace(EFFECTS[0], name="paint", parameters=(replace(colour, name="shade"),)),
        )

    def with_effects(self, values):
        return super().with_effects({name: of for name, of in values.items() if name != "paint"})


@pytest.mark.slow
def test_an_effect_that_does_nothing_is_told_and_no_rival(quick):
    spec, runs = s2r.parse_spec(SPEC), rollouts({"coulomb": 1.2}, 11)
    found = s2r.diagnose(spec, Painted(), runs, cache=quick, where=False)
    assert " paint " in found.notes[0]
    assert found.verdict is Verdict.NAMED
    assert found.which.answer == ("coulomb",)
    assert "paint" not in found.which.singles


class Twice(Cart):
    """A cart whose dry friction stands in the catalogue under two names."""

    def effects(self):
        (rub,) = [effect for effect in super().effects() if effect.name == "coulomb"]
        return (*super().effects(), replace(rub, name="rub"))

    def with_effects(self, values):
        force = sum(values.get(name, {}).get("force", 0.0) for name in ("coulomb", "rub"))
        rest = {name: of for name, of in values.items() if name not in ("coulomb", "rub")}
        return super().with_effects(rest | ({"coulomb": {"force": force}} if force else {}))


@pytest.mark.slow
def test_no_test_is_proposed_to_tell_apart_what_is_the_same(quick):
    spec, runs = s2r.parse_spec(SPEC), rollouts({"coulomb": 1.2}, 11)
    found = s2r.diagnose(spec, Twice(), runs, cache=quick, where=False)
    assert set(found.which.answer) <= {"coulomb", "rub"}
    assert {"coulomb", "rub"} <= set(found.which.confounded)
    planned = found.which.next_test
    assert planned is None or not {"coulomb", "rub"} <= set(planned.separates)


def test_two_effects_are_named_together(find):
    found = find({"coulomb": 1.2, "speed_scale": 0.85}, case=12, n=16)
    assert set(found.which.answer) == {"coulomb", "speed_scale"}, found.which.ranked[:4]
    assert set(found.patch) == {"coulomb", "speed_scale"}


@pytest.mark.slow
def test_a_simulator_whose_derivatives_are_dear_is_diagnosed_by_the_bank_and_a_few_looks(cache, monkeypatch):
    looked = []
    simulated = Simulator._simulated

    def noted(self, points, places):
        looked.extend((at.tobytes(), places.tobytes()) for at in points)
        return simulated(self, points, places)

    monkeypatch.setattr(Simulator, "_simulated", noted)
    spec = s2r.parse_spec(SPEC)
    true = {"coulomb": 1.2, "speed_scale": 0.85}
    found = s2r.diagnose(spec, Cart(cost=0.3), rollouts(true, 12), cache=cache, where=False)
    assert set(found.which.answer) == set(true), found.which.ranked[:4]
    for estimate in found.which.estimates:
        nominal = {"speed_scale": 1.0}.get(estimate.effect, 0.0)
        assert abs(estimate.value - true[estimate.effect]) < 0.35 * abs(true[estimate.effect] - nominal)
    assert len(looked) == len(set(looked)), "the same rollouts were run twice"


@pytest.mark.slow
def test_where_the_bank_explains_a_dear_machine_only_what_is_named_is_simulated(cache, monkeypatch):
    prepare = sys.modules["s2r_spec.diagnose.prepare"]
    spec, runs = s2r.parse_spec(SPEC), rollouts({"coulomb": 1.2}, 11)
    looks, answers = [], []
    simulated = Simulator._simulated

    def noted(self, points, places):
        looks[-1] += len(points)
        return simulated(self, points, places)

    monkeypatch.setattr(Simulator, "_simulated", noted)
    for faithful in (1e9, -1.0):
        monkeypatch.setattr(prepare, "FAITHFUL", faithful)
        looks.append(0)
        found = s2r.diagnose(spec, Cart(cost=0.3), runs, cache=cache, where=False)
        answers.append(found.which.answer)
    assert answers == [("coulomb",), ("coulomb",)]
    assert 0 < looks[0] <= looks[1] / 2


def test_a_machine_with_a_little_of_everything_has_no_material_gap(cache):
    """Of a rollout that ended early, and was left out, the answer says that it was."""
    some = rollouts({}, case=14)
    some[4] = (some[4][0], replace(some[4][1], meta={"failure": "emergency stop"}))
    found = s2r.diagnose(s2r.parse_spec(SPEC), Cart(), some, cache=cache, where=False)
    assert found.verdict is Verdict.NONE, found.which.ranked[:4]
    assert found.which.answer == ()
    assert found.patch == {}
    assert "1 of 30 rollouts" in found.reason
    [note] = [note for note in found.notes if "ended early" in note]
    assert note.startswith("1 of 30 real rollouts ended early")
    assert "No single effect" in note


def test_a_cause_that_the_catalogue_lacks_is_none_of_these(find):
    found = find({}, case=14, extra="gust", n=16)
    assert found.verdict is Verdict.UNKNOWN, found.which.ranked[:4]
    assert found.which.answer == ()
    assert found.which.unknown > 0.3
    assert found.which.nearest_family


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effects", "surplus", "verdict"),
    [
        ({"coulomb": 1.5}, 1.4, Verdict.UNKNOWN),
        ({"coulomb": 1.5}, 0.9, Verdict.NAMED),
        ({}, 1.4, Verdict.NONE),  # every machine does something that its simulator does not
    ],
)
def test_what_no_effect_leaves_of_a_material_gap_is_none_of_these(
    find, monkeypatch, effects, surplus, verdict
):
    push = Remainder("force", 0, "", "v", 0.3, 0.4, 2.5, "N", "m/s", surplus)
    run = sys.modules["s2r_spec.diagnose.run"]
    monkeypatch.setattr(run, "remainders", lambda *rest, **more: (push,))
    found = find(effects, case=11 if effects else 13)
    assert found.left == (push,)
    assert (found.verdict is Verdict.UNKNOWN) is (verdict is Verdict.UNKNOWN), found.reason
    if verdict is Verdict.UNKNOWN:
        assert "+2.5 N of force where v is between 0.3 and 0.4 m/s" in found.reason
        assert found.which.unknown >= 0.5
        assert found.patch == {}
    else:
        assert ("2.5 N" in found.reason) is (surplus > 1.0)


def test_effects_that_look_alike_are_known_before_any_real_test(rubbing):
    isolable = rubbing.which.isolability
    names = isolable.effects
    sigma = isolable.sigma
    payload, motor = names.index("payload"), names.index("motor")
    others = np.delete(sigma[payload], [payload, motor])
    assert sigma[payload, motor] < 0.75 * others.min()
    assert np.all(np.diag(sigma) == 0)


def test_the_answer_is_a_distribution(rubbing):
    assert str(rubbing) == f"{rubbing.verdict.value}: {rubbing.reason}"
    found = rubbing.to_json()
    which = found["which"]
    total = sum(which["posterior"].values()) + sum(p["probability"] for p in which["pairs"]) + which["others"]
    assert total == pytest.approx(1.0, abs=1e-4)
    json.dumps(found, allow_nan=False)


@pytest.mark.slow
def test_the_same_data_have_the_same_answer(find):
    first, second = (find({"coulomb": 1.5}, case=11, where=True).to_json() for _ in range(2))
    assert first == second
    json.dumps(first, allow_nan=False)


@pytest.mark.slow
def test_channels_that_the_log_lacks_are_done_without(quick):
    spec = s2r.parse_spec(SPEC)
    short = [(test, trace.only(["v", "v_ref"])) for test, trace in rollouts({"tilt": 1.4}, 15)]
    found = s2r.diagnose(spec, Cart(), short, cache=quick, where=False)
    assert found.which.ranked[0][0] == ("tilt",)


def test_a_simulator_without_effects_is_told_what_to_do():
    class Bare(Cart):
        effects = None

    spec = s2r.parse_spec(SPEC)
    bare = Bare()
    object.__setattr__(bare, "effects", lambda: ())
    with pytest.raises(s2r.S2RError, match="no effects"):
        s2r.diagnose(spec, bare, rollouts({}, 1))


def test_too_few_rollouts_are_refused(cache):
    with pytest.raises(s2r.S2RError, match="at least 6 "):
        s2r.diagnose(s2r.parse_spec(SPEC), Cart(), rollouts({}, 1, n=4), cache=cache)


def test_a_test_outside_the_ranges_is_refused_before_anything_is_simulated(cache):
    wrong = [*rollouts({}, 3), ({"vd": 7.0, "acc": 2.0}, real({"vd": 0.5, "acc": 2.0}, 1, {}))]
    with pytest.raises(UsageError, match=r"vd = 7 m/s is outside \[0\.2, 1\]"):
        s2r.diagnose(s2r.parse_spec(SPEC), Cart(), wrong, cache=cache)


def test_rollouts_asked_of_a_machine_are_kept_and_not_asked_again(tmp_path, cache, toy):
    spec = s2r.parse_spec(SPEC)
    machine = s2r.load_backend("cart:real.coulomb=1.5")
    first = s2r.diagnose(spec, Cart(), machine, 8, cache=cache, folder=tmp_path / "real", where=False)
    assert len(list((tmp_path / "real").glob("*.npz"))) == 8
    recorded = s2r.load_backend(f"log:{tmp_path / 'real'}")
    assert len(recorded.recordings) == 8

    class Broken(type(machine)):
        def rollout(self, params, seed):
            raise AssertionError("asked again")

    broken = Broken(machine.truth)
    again = s2r.diagnose(spec, Cart(), broken, 8, cache=cache, folder=tmp_path / "real", where=False)
    assert again.to_json() == first.to_json()


def test_the_answer_does_not_hang_on_how_many_threads_there_are(find, monkeypatch):
    import scipy.linalg  # noqa: F401
    from threadpoolctl import threadpool_info, threadpool_limits

    class ReachedError(Exception):
        pass

    def threads():
        return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]

    def reached(*_):
        raise ReachedError(threads())

    run = sys.modules["s2r_spec.diagnose.run"]
    with threadpool_limits(2):
        before = threads()
        for module, name in (
            (run.banks, "bank"),
            (run, "prepare"),
        ):  # before anything is simulated, and learnt
            with monkeypatch.context() as patched:
                patched.setattr(module, name, reached)
                with pytest.raises(ReachedError) as error:
                    find({}, case=1)
            assert set(error.value.args[0]) == {1}
        assert threads() == before  # what the user's own program has is given back


def test_the_diagnosis_cannot_see_a_label():
    code = "import s2r_spec.diagnose.run, sys; print(' '.join(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not [name for name in done.stdout.split() if name.startswith(("s2r_spec.blind", "benchmarks"))]


class Short(Cart):
    """A cart whose catalogue is short."""

    def effects(self):
        return tuple(e for e in super().effects() if e.name in ("coulomb", "viscous"))


@pytest.mark.slow
def test_a_catalogue_of_two_effects_is_enough(quick):
    found = s2r.diagnose(
        s2r.parse_spec(SPEC), Short(), rollouts({"viscous": 2.0}, 11), cache=quick, where=False
    )
    assert set(found.which.singles) == {"coulomb", "viscous"}
    assert found.which.ranked[0][0] == ("viscous",), found.reason


class Narrow(Cart):
    """A cart whose catalogue has little more than half of the machine's friction, and two more effects."""

    def effects(self):
        few = [e for e in super().effects() if e.name in ("viscous", "payload", "speed_scale")]
        least = {"viscous": 1.15}
        return tuple(
            replace(e, parameters=tuple(replace(p, high=least.get(e.name, p.high)) for p in e.parameters))
            for e in few
        )


@pytest.mark.slow
def test_a_cause_that_takes_more_than_its_range_has_is_none_of_these(quick):
    found = s2r.diagnose(
        s2r.parse_spec(SPEC), Narrow(), rollouts({"viscous": 2.0}, 11), cache=quick, where=False
    )
    assert found.how_far.short
    assert not found.how_far.open  # a good half is closed: no other rule says so
    assert found.verdict is Verdict.UNKNOWN
    assert "viscous.coefficient is at the end of its range" in found.reason
    assert found.patch == {}


@dataclass(frozen=True)
class Limited(Cart):
    """A cart whose drive may saturate earlier: at 12 V no test does, at 5 V a third do."""

    def effects(self):
        voltage = EffectParameter(
            "voltage", "V", 2.0, VOLTAGE, VOLTAGE, "normal around 12, standard deviation 3"
        )
        few = tuple(e for e in super().effects() if e.name in ("coulomb", "viscous", "payload"))
        return (*few, Effect("limit", "actuation", "The drive saturates.", (voltage,)))

    def with_effects(self, values):
        rest = {name: of for name, of in values.items() if name != "limit"}
        lowest = values.get("limit", {}).get("voltage", self.limit)
        return replace(super().with_effects(rest), limit=lowest)


@pytest.mark.slow
def test_a_limit_that_some_tests_reach_is_found_with_its_value(quick):
    tests = [test for test, _ in rollouts({}, 11)]
    seen = [(test, real(test, 11000 + i, {}, limit=5.0)) for i, test in enumerate(tests)]
    reached = sum(np.abs(trace["u"]).max() >= 5.0 - 1e-9 for _, trace in seen)
    assert 0 < reached < len(seen) / 2
    found = s2r.diagnose(s2r.parse_spec(SPEC), Limited(), seen, cache=quick, where=False)
    assert found.which.ranked[0][0] == ("limit",), found.which.ranked[:4]
    (estimate,) = found.which.estimates
    assert abs(estimate.value - 5.0) < 0.3
    # Only one test reaches it, and that was held out.
    hardest = max(range(len(seen)), key=lambda i: np.abs(real(tests[i], 11000 + i, {})["u"]).max())
    easy = [i for i in range(len(seen)) if np.abs(seen[i][1]["u"]).max() < 4.5][:20]
    places = {easy[0]: hardest}
    one = [seen[places.get(i, i)] for i in easy]
    held = split(one, 0)[1]
    k = next(i for i, (test, _) in enumerate(one) if test == held[0][0])
    one[0], one[k] = one[k], one[0]
    assert one[k][0] == tests[hardest]
    again = s2r.diagnose(s2r.parse_spec(SPEC), Limited(), one, cache=quick, where=False)
    assert again.which.ranked[0][0] == ("limit",), again.which.ranked[:4]
    assert "held-out tests" in again.notes[-1]
    assert again.verdict is Verdict.NAMED
    assert " closes " not in again.reason


@dataclass(frozen=True)
class Saturating(Cart):
    """A cart with all of its effects, whose drive may saturate earlier as well."""

    def effects(self):
        return (*super().effects(), *(e for e in Limited().effects() if e.name == "limit"))

    def with_effects(self, values):
        rest = {name: of for name, of in values.items() if name != "limit"}
        lowest = values.get("limit", {}).get("voltage", self.limit)
        return replace(super().with_effects(rest), limit=lowest)


@pytest.mark.slow
def test_a_fit_of_everything_that_went_astray_does_not_rule_out_what_explains_all_alone(quick):
    rng = np.random.default_rng(11)
    tests = [{"vd": rng.uniform(0.2, 1), "acc": rng.uniform(1, 4)} for _ in range(60)]
    needed = [np.abs(real(test, 11000 + i, {})["u"]).max() for i, test in enumerate(tests)]
    order = np.argsort(needed).tolist()
    # Two tests saturate; one of them is held out, and the one that is seen looks like many effects at once.
    gentle = [i for i in order if needed[i] < 4.0][:18]
    hard = [i for i in order[::-1] if needed[i] > 4.8][:2]
    places = enumerate(tests[i] for i in gentle + hard)
    seen = [(test, real(test, 11000 + i, {}, limit=4.2)) for i, test in places]
    assert sum(np.abs(trace["u"]).max() >= 4.2 - 1e-9 for _, trace in split(seen, 0)[0]) == 1
    found = s2r.diagnose(s2r.parse_spec(SPEC), Saturating(), seen, cache=quick, where=False)
    assert found.which.ranked[0][0] == ("limit",), found.which.ranked[:4]
    assert found.which.unknown < 0.3
    assert abs(found.which.estimates[0].value - 4.2) < 0.3


def test_tests_that_alone_show_a_gap_change_places_with_as_many_others():
    numbered = [({"v": float(k // 2)}, k) for k in range(20)]  # two rollouts a test
    seen, held = exchanged(numbered[:14], numbered[14:], [{"v": 8.0}], seed=0)
    assert sorted([*seen, *held], key=lambda one: one[1]) == numbered
    assert [one for one in seen if one[0]["v"] == 8.0] == seen[-2:] == numbered[16:18]
    assert len(seen) == 14
    assert exchanged(numbered[:14], numbered[14:], [{"v": 8.0}], seed=0) == (seen, held)


class Shortest(Cart):
    """A cart whose catalogue has one effect."""

    def effects(self):
        return tuple(e for e in super().effects() if e.name == "viscous")


@pytest.mark.slow
def test_a_catalogue_of_one_effect_is_enough(quick):
    found = s2r.diagnose(
        s2r.parse_spec(SPEC), Shortest(), rollouts({"viscous": 2.0}, 11), cache=quick, where=False
    )
    assert found.which.ranked[0][0] == ("viscous",), found.reason
    assert found.which.answer == ("viscous",)


class Deaf(Cart):
    """A cart that does not listen to its only effect."""

    def effects(self):
        return tuple(e for e in super().effects() if e.name == "viscous")

    def with_effects(self, values):
        return self


def test_a_catalogue_that_changes_nothing_is_told_of(tmp_path):
    with pytest.raises(UsageError, match="no effect of the catalogue"):
        s2r.diagnose(s2r.parse_spec(SPEC), Deaf(), rollouts({"viscous": 2.0}, 11), cache=tmp_path)


@pytest.mark.slow
def test_the_simulator_itself_has_no_material_gap(find, cache):
    spec = s2r.parse_spec(SPEC)
    rng = np.random.default_rng(5)
    tests = [{"vd": rng.uniform(0.2, 1), "acc": rng.uniform(1, 4)} for _ in range(20)]
    same = [(test, Cart().rollout(test, 500 + i)) for i, test in enumerate(tests)]
    found = s2r.diagnose(spec, Cart(), same, cache=cache, where=False)
    assert found.verdict is Verdict.NONE, found.reason


def test_the_page_on_logs_does_what_it_says(cache, monkeypatch, capsys):
    """Its Python, with the cart in the place of the axis, whose bank would take half a minute."""
    page = Path(__file__).parents[2] / "docs" / "how-to" / "diagnose-logs.md"
    (code,) = re.findall(r"```python\n(.*?)```", page.read_text(), re.S)
    for words, instead in {
        's2r.load_spec("specs/emps_tracking.stl")': "s2r.parse_spec(SPEC)",
        's2r.load_backend("emps:coulomb.force=20")': 'Cart().with_effects({"coulomb": {"force": 1.5}})',
        '"emps"': "Cart()",
    }.items():
        assert code.count(words) == 1
        code = code.replace(words, instead)
    monkeypatch.setenv("S2R_CACHE", str(cache))
    names = {"SPEC": SPEC, "Cart": Cart}
    exec(code, names)
    assert names["found"].which.answer == ("coulomb",)
    shown = capsys.readouterr().out
    assert "('coulomb',)" in shown
    assert "closes" in shown
