"""Whole diagnoses: of the cart by another author, and of a machine that needs its protocols."""

import json
import re
import sys
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path

import numpy as np
import pytest
import s2r_cart
from s2r_cart import EFFECTS, SPEC, Cart, Machine, real

import s2r_spec as s2r
from s2r_spec.base.json_values import to_json
from s2r_spec.diagnose.decision import Rule, Verdict
from s2r_spec.diagnose.inference.estimates import Status
from s2r_spec.diagnose.residuals.left import Remainder
from s2r_spec.errors import BackendError, UsageError
from s2r_spec.report.advice import next_step
from s2r_spec.trace import Trace
from s2r_spec.workers.worker_process import WorkerDiedError
from tests.diagnose.toy import Toy
from tests.errors import naming, states

CART = s2r.parse_spec(SPEC)
ROLLOUTS = count()
TOY = s2r.parse_spec("""
param  v in [0, 1]
signal x {N}
require small: always[0, 0.9 s] (abs(x) <= 2 {N})
certify small: delta = 0.1, epsilon = 0.05, B = 1, R = 0.05, kernel = rbf(0.5), fall = -1
""")


@pytest.fixture(scope="module")
def find(cache):
    """Diagnose a machine or rollouts; where is asked for by those alone who say so, for it takes half of the time."""

    def diagnosed(machine, budget=None, sim=None, spec=CART, where=False, **more):
        return s2r.diagnose(spec, sim or Cart(), machine, budget, cache=cache, where=where, **more)

    return diagnosed


def machine(**effects):
    return Machine(tuple(effects.items()))


def logs(effects, case, n=16, extra=None):
    """Return rollouts at random tests, one each."""
    rng = np.random.default_rng(case)
    tests = [{"vd": rng.uniform(0.2, 1), "acc": rng.uniform(1, 4)} for _ in range(n)]
    return [(test, real(test, 1000 * case + i, effects, extra=extra)) for i, test in enumerate(tests)]


def estimate(found, effect):
    """Return the estimate of an effect of one parameter."""
    [one] = [one.parameters[0] for one in found.which.effects if one.effect == effect]
    return one


@pytest.fixture(scope="module")
def rubbing(find):
    """The answer to a machine with dry friction."""
    return find(machine(coulomb=1.5), 16)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("coulomb", 1.5),
        pytest.param("tilt", -1.6, marks=pytest.mark.slow),
        pytest.param("viscous", 2.0, marks=pytest.mark.slow),
        pytest.param("payload", 1.2, marks=pytest.mark.slow),
        pytest.param("delay", 0.04, marks=pytest.mark.slow),
    ],
)
def test_a_cause_is_named_with_its_size_and_closes_the_gap(find, rubbing, name, value):
    found = rubbing if name == "coulomb" else find(machine(**{name: value}), 16)
    assert (found.verdict, found.which.answer) == (Verdict.NAMED, (name,)), found.reason
    one = estimate(found, name)
    assert abs(one.value - value) < 0.3 * abs(value)
    assert name == "coulomb" or one.low <= value <= one.high
    assert found.patch == {name: {one.parameter: one.value}}
    # Dry friction of the machine grows with speed up to 0.02 m/s, so its size comes out smaller, and it closes less.
    assert found.how_far.share.estimate > (0.6 if name == "coulomb" else 0.8)
    assert found.tuned[name]


def test_a_healthy_machine_has_no_material_gap(find):
    found = find(machine(), 16)
    assert (found.verdict, found.which.answer, found.patch) == (Verdict.NONE, (), {})
    assert all(one.parameters and one.status is not Status.NAMED for one in found.which.effects)


def test_two_causes_are_named_together(find):
    found = find(machine(coulomb=1.8, speed_scale=0.85), 16)
    assert found.verdict is Verdict.NAMED
    assert set(found.which.answer) == set(found.patch) == {"coulomb", "speed_scale"}
    one = estimate(found, "speed_scale")
    assert one.low <= 0.85 <= one.high


def test_a_cause_that_the_catalogue_lacks_is_none_of_these(find):
    found = find(logs({}, 14, 12, extra="gust"))
    assert (found.verdict, found.which.answer, found.patch) == (Verdict.UNKNOWN, (), {})
    assert found.left[0].low == pytest.approx(1.0, abs=0.1)


@pytest.fixture(scope="module")
def tilted(find):
    """The answer to logs of a machine on a slope, without that of the fifth test."""
    runs = logs({"tilt": 1.4}, 15, 12)
    return find([*runs[:4], *runs[5:]])


@pytest.mark.parametrize(
    ("value", "name"), [(1.4, "tilt"), pytest.param(2.0, "viscous", marks=pytest.mark.slow)]
)
def test_logs_at_any_tests_name_a_cause(find, tilted, value, name):
    found = tilted if name == "tilt" else find(logs({name: value}, 15))
    assert (found.verdict, found.which.answer) == (Verdict.NAMED, (name,)), found.reason
    assert estimate(found, name).value == pytest.approx(value, rel=0.2)
    assert found.passive


def test_channels_that_the_log_lacks_are_done_without(find):
    found = find([(test, trace.only(["v", "v_ref"])) for test, trace in logs({"tilt": 1.4}, 15, 12)])
    assert found.which.answer == ("tilt",)
    assert states(found.notes[0], "v_meas, u")


def test_an_accident_changes_nothing_that_is_said_of_the_others(find, tilted):
    runs = logs({"tilt": 1.4}, 15, 12)
    test, trace = runs[4]
    first = {name: values[:60] for name, values in trace.channels.items()}
    runs[4] = (test, Trace(trace.times[:60], first, trace.units, {"failure": "fall"}))
    found = find(runs)
    assert states(found.notes[0], "1 of 12", "(fall)", "left out")
    assert to_json(found.which) == to_json(tilted.which)
    assert found.how_far == tilted.how_far


class KilledError(BaseException):
    """Nothing catches it, as nothing catches a kill."""


@dataclass(frozen=True)
class Mortal(Toy):
    """A machine that a kill stops at a run of its life."""

    left: list = None

    def _trace(self, values, seed):
        if self.left is not None:
            if not self.left[0]:
                raise KilledError
            self.left[0] -= 1
        return super()._trace(values, seed)


def mortal(runs=None):
    return Mortal((("a", 1.6), ("d", -1.5)), left=None if runs is None else [runs])


def test_a_campaign_that_is_killed_goes_on_to_the_same_answer(find, tmp_path):
    for kill in (2, 15):
        with pytest.raises(KilledError):
            find(mortal(kill), 24, Toy(), TOY, where=True, folder=tmp_path / str(kill))
    whole = find(mortal(), 24, Toy(), TOY, where=True, folder=tmp_path / "whole")
    assert set(whole.which.answer) == {"a", "d"}
    ran = len(list((tmp_path / "whole").glob("*.npz")))
    for kill in (2, 15):
        again = find(mortal(ran - kill), 24, Toy(), TOY, where=True, folder=tmp_path / str(kill))
        assert again.to_json() == whole.to_json()
    json.dumps(whole.to_json(), allow_nan=False)
    # The folder of a campaign can be diagnosed as logs, too.
    read = find(s2r.load_backend(f"log:{tmp_path / 'whole'}"), None, Toy(), TOY)
    assert set(read.which.answer) == {"a", "d"}


def test_protocols_tell_apart_what_the_test_does_not(find):
    of = replace(Toy(), added=(("a", 2.0),))
    found = find(of, 24, Toy(), TOY)
    assert (found.verdict, found.which.answer, found.passive) == (Verdict.NAMED, ("a",), False)
    assert estimate(found, "a").value == pytest.approx(2.0, rel=0.1)
    for names in ((), ("show",)):
        without = find(of, 24, Toy(), TOY, protocols=names)
        assert without.verdict is Verdict.CONFOUNDED
        assert {one.effect for one in without.which.possible} == {"a", "b"}
        assert states(next_step(without, TOY), "split")
        assert without.how_far.tuned_share.estimate > 0.9
    passive = find(of, 24, Toy(), TOY, passive=True)
    assert (passive.verdict, passive.passive) == (Verdict.CONFOUNDED, True)
    status = {one.effect: one.status for one in passive.which.effects}
    assert status == {"a": Status.POSSIBLE, "b": Status.POSSIBLE, "c": Status.HIDDEN, "d": Status.HIDDEN}


def test_a_budget_below_the_screen_and_a_wrong_protocol_get_one_sentence(find):
    of = replace(Toy(), added=(("a", 2.0),))
    with pytest.raises(UsageError, match=naming("7", "8", "--budget", "--protocols")):
        find(of, 7, Toy(), TOY)
    with pytest.raises(UsageError, match=naming("'shwo'", "'show'")):
        find(of, 24, Toy(), TOY, protocols=("shwo",))


def test_order_of_channels_and_of_the_catalogue_change_nothing(find, rubbing, monkeypatch, tmp_path):
    @dataclass(frozen=True)
    class Turned(Machine):
        def rollout(self, params, seed):
            trace = super().rollout(params, seed)
            return replace(trace, channels=dict(reversed(trace.channels.items())))

    of = Turned()
    object.__setattr__(of, "truth", (("coulomb", 1.5),))
    monkeypatch.setattr(s2r_cart, "EFFECTS", tuple(reversed(EFFECTS)))
    turned = replace(Cart(), channels=tuple(reversed(Cart().channels)))
    found = s2r.diagnose(CART, turned, of, 16, cache=tmp_path, where=False)
    assert found.rule is rubbing.rule
    assert found.which.membership == pytest.approx(rubbing.which.membership, abs=2e-3)
    for one in found.which.effects:
        assert one.largest.value == pytest.approx(estimate(rubbing, one.effect).value, abs=2e-3)
    for one, other in (
        (found.how_far.before, rubbing.how_far.before),
        (found.how_far.after, rubbing.how_far.after),
    ):
        assert one.mean == pytest.approx(other.mean, rel=0.02)


class Dying(ThreadPoolExecutor):
    """A pool whose workers die."""

    def submit(self, function, /, *arguments, **named):
        future = Future()
        future.set_exception(WorkerDiedError("the worker died", begun=True))
        return future


def test_a_killed_pool_gets_one_sentence(find):
    with pytest.raises(BackendError, match=naming("worker died", "'cart'", "--workers 1")):
        find(machine(coulomb=1.5), 16, replace(Cart(), cost=0.1), executor=lambda: Dying(1))


def test_the_answer_is_a_distribution(rubbing):
    assert str(rubbing) == f"{rubbing.verdict.value}: {rubbing.reason}"
    found = rubbing.to_json()
    which = found["which"]
    total = sum(which["posterior"].values()) + sum(p["probability"] for p in which["pairs"]) + which["others"]
    assert total == pytest.approx(1.0, abs=1e-4)
    assert set(which["status"]) == set(which["parameters"]) == {effect.name for effect in EFFECTS}
    json.dumps(found, allow_nan=False)


class Painted(Toy):
    """A machine one of whose effects does nothing."""

    def effects(self):
        return (*super().effects(), replace(super().effects()[0], name="paint"))

    def with_effects(self, values):
        return super().with_effects({name: of for name, of in values.items() if name != "paint"})


def test_an_effect_that_does_nothing_is_told_and_not_named(find):
    found = find(replace(Toy(), added=(("c", 2.0),)), 24, Painted(), TOY)
    assert states(found.notes[0], "paint", "nothing")
    assert found.which.answer == ("c",)
    assert "paint" in found.which.hidden or "paint" not in found.which.membership


class Few(Toy):
    """A machine whose catalogue has one effect."""

    def effects(self):
        return super().effects()[:1]


class Narrow(Few):
    """The same, whose range ends before the machine's value."""

    def effects(self):
        (one,) = super().effects()
        return (replace(one, parameters=(replace(one.parameters[0], low=-1.0, high=1.0),)),)


class Deaf(Few):
    """A machine that does not listen to its only effect."""

    def with_effects(self, values):
        return self


def test_a_catalogue_of_one_effect_is_enough_if_its_range_is(find):
    of = replace(Toy(), added=(("a", 2.0),))
    assert find(of, 24, Few(), TOY, protocols=("split",)).which.answer == ("a",)
    found = find(of, 24, Narrow(), TOY, protocols=("split",))
    assert (found.verdict, found.patch) == (Verdict.UNKNOWN, {})
    assert found.evidence.at_end == ("a.size",)
    with pytest.raises(UsageError):
        find(of, 24, Deaf(), TOY, protocols=("split",))


@pytest.mark.parametrize("surplus", [1.4, 0.9])
def test_motion_that_no_effect_explains_is_told_beside_a_cause_that_closes_the_gap(
    find, monkeypatch, surplus
):
    push = Remainder("force", 0, "", "v", 0.3, 0.4, 2.5, "N", "m/s", surplus)
    monkeypatch.setattr(sys.modules["s2r_spec.diagnose.run"], "remainders", lambda *rest, **more: (push,))
    found = find(replace(Toy(), added=(("a", 2.0),)), 24, Toy(), TOY)
    assert (found.left, found.rule) == ((push,), Rule.EFFECT)
    assert ("+2.5 N of force where v is between 0.3 and 0.4 m/s" in found.reason) is (surplus > 1.0)


def test_what_cannot_be_diagnosed_gets_one_sentence(find):
    class Bare(Cart):
        def effects(self):
            return ()

    inside = real({"vd": 0.5, "acc": 2.0}, 1, {})
    attended = machine()
    object.__setattr__(attended, "exclusive", True)
    for real_side, sim, words in (
        (logs({}, 1), Bare(), ("declares no effects", "'cart'")),
        (logs({}, 1, 4), None, ("4 real rollouts", "at least 6 ")),
        ([*logs({}, 3), ({"vd": 7.0, "acc": 2.0}, inside)], None, ("rollout 16", "vd = 7 m/s", "[0.2, 1]")),
        ([*logs({}, 3), ({"vd": 0.5}, inside)], None, ("rollout 16", "'acc'")),
        ([({"vd": 0.5, "acc": 2.0}, "trace")] * 9, None, ("(params, Trace)",)),
        (attended, None, ("operator", "log:")),
        (machine(), attended, ("operator",)),
        (Toy(), None, ("'toy'", "'v'")),
    ):
        with pytest.raises(s2r.S2RError, match=naming(*words)):
            find(real_side, sim=sim)
    with pytest.raises(UsageError, match="tracing"):
        find(machine(), requirement="tracing")


def test_the_page_on_logs_does_what_it_says(cache, monkeypatch, capsys):
    """Its Python, with the cart in the place of the axis, whose library would take half a minute."""
    page = Path(__file__).parents[2] / "docs" / "how-to" / "diagnose-logs.md"
    (code,) = re.findall(r"```python\n(.*?)```", page.read_text(), re.S)
    for words, instead in {
        's2r.load_spec("specs/emps_tracking.stl")': "s2r.parse_spec(SPEC)",
        's2r.load_backend("emps:coulomb.force=20")': 'Cart().with_effects({"tilt": {"force": 1.5}})',
        '"emps"': "Cart()",
    }.items():
        assert code.count(words) == 1
        code = code.replace(words, instead)
    monkeypatch.setenv("S2R_CACHE", str(cache))
    names = {"SPEC": SPEC, "Cart": Cart}
    exec(code, names)
    assert names["found"].which.answer == ("tilt",)
    assert "('tilt',)" in capsys.readouterr().out


class Remembers(Cart):
    """Its traces depend on how many rollouts this process has run."""

    def rollout(self, params, seed):
        trace = super().rollout(params, seed)
        late = 1e-9 * next(ROLLOUTS)
        return Trace(trace.times, {name: x + late for name, x in trace.channels.items()}, trace.units)


def test_a_simulator_with_a_memory_gets_no_diagnosis(find):
    with pytest.raises(UsageError) as caught:
        find(machine(), 12, sim=Remembers())
    assert states(str(caught.value), "memory", "seed 0", "t = 0 s")
