"""A cause that falls alone show: asked of a cart with a guard, whose drive may saturate."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from s2r_cart import SPEC, VOLTAGE, Cart

import s2r_spec as s2r
from s2r_spec.backend import Effect, EffectParameter
from s2r_spec.diagnose.accused import named_by_falls
from s2r_spec.diagnose.axes import lines
from s2r_spec.diagnose.diagnosis import Verdict
from s2r_spec.diagnose.falls import Culprit, Falls
from s2r_spec.report.nextstep import next_step

pytestmark = pytest.mark.filterwarnings("ignore::sklearn.exceptions.ConvergenceWarning")

OFF = 0.02
"""Speed [m/s] that the cart may be off from the same cart that does not saturate, before the guard stops it."""


@dataclass(frozen=True)
class Guarded(Cart):
    """A cart that stops as soon as its drive saturates noticeably: what that does to a whole rollout nobody sees."""

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

    def rollout(self, params, seed):
        trace = super().rollout(params, seed)
        free = Cart.rollout(replace(self, limit=VOLTAGE), params, seed)
        if np.abs(trace["v"] - free["v"]).max() > OFF:
            return replace(trace, meta=dict(trace.meta) | {"failure": "drive saturated"})
        return trace


def recorded(limit, again=3):
    rng = np.random.default_rng(11)
    tests = [{"vd": rng.uniform(0.2, 1), "acc": rng.uniform(1, 4)} for _ in range(60)]
    needed = [np.abs(Cart().rollout(test, 5)["u"]).max() for test in tests]
    order = np.argsort(needed).tolist()
    asked = [tests[i] for i in order if needed[i] < limit - 0.3][:27] + [tests[order[-1]]] * again
    machine = Guarded().with_effects({"limit": {"voltage": limit}})
    return [(test, machine.rollout(test, 900 + i)) for i, test in enumerate(asked)]


@pytest.mark.slow
def test_what_alone_makes_the_simulator_fall_where_the_machine_always_does_is_named(quick):
    seen = recorded(5.5)
    assert [trace.failure is not None for _, trace in seen] == [False] * 27 + [True] * 3
    found = s2r.diagnose(s2r.parse_spec(SPEC), Guarded(), seen, cache=quick, where=False)
    assert found.verdict is Verdict.NAMED, found.reason
    assert found.which.answer == ("limit",)
    (estimate,) = found.which.estimates
    assert estimate.low <= 5.5 <= estimate.high
    assert estimate.low <= estimate.value <= estimate.high
    assert list(found.patch) == ["limit"]
    assert found.improved(tuned=True)["limit"] == found.patch["limit"]
    assert found.by_falls
    assert found.to_json()["by_falls"]
    assert "at tests next to those where it falls" in next_step(found, s2r.parse_spec(SPEC))
    assert "0.2" in found.assumptions[-1]
    assert "0.02" in found.assumptions[-1]
    assert "limit.voltage beyond " in found.reason
    ranked = found.which.ranked
    assert ranked[0][0] == ("limit",)
    assert sum(p for _, p in ranked) == pytest.approx(1.0)
    # What is named makes the simulator stop there, too, and nowhere else.
    improved = Guarded().with_effects(found.patch)
    assert [improved.rollout(test, 3).failure is not None for test, _ in seen] == [False] * 27 + [True] * 3

    # Once is an accident.
    found = s2r.diagnose(s2r.parse_spec(SPEC), Guarded(), recorded(5.5, 1), cache=quick, where=False)
    assert found.verdict is Verdict.NONE
    assert found.which.answer == ()
    assert found.patch == {}
    assert not found.by_falls
    assert "1 of 28 rollouts" in found.reason

    # Nor is anything named where the simulator ends early as well, or nothing alone ends it, or next to nothing does.
    limit = next(line for line in lines(Guarded().effects()) if line.effect == "limit")
    for why in (None, Falls(True), Falls(False), Falls(False, (Culprit(limit, -0.14, 0),), 6)):
        assert named_by_falls(found, None, why) is found


@pytest.mark.slow
def test_where_many_fall_what_closes_the_gap_by_falling_there_too_is_named(quick):
    rng = np.random.default_rng(11)
    tests = [{"vd": rng.uniform(0.2, 1), "acc": rng.uniform(1, 4)} for _ in range(30)]
    machine = Guarded().with_effects({"limit": {"voltage": 5.0}})
    seen = [(test, machine.rollout(test, 900 + i)) for i, test in enumerate(tests)]
    fell = sum(trace.failure is not None for _, trace in seen)
    assert 4 <= fell <= 12
    found = s2r.diagnose(s2r.parse_spec(SPEC), Guarded(), seen, cache=quick, where=False)
    assert found.verdict is Verdict.NAMED, found.reason
    assert found.which.answer == ("limit",)
    assert found.by_falls
    (estimate,) = found.which.estimates
    assert estimate.low <= 5.0 <= estimate.high
    assert found.how_far.material
    assert found.how_far.share[0] > 0.8
    assert f"{100 * min(found.how_far.share[0], 1.0):.0f} %" in found.reason
