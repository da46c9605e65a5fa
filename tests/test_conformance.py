"""Conformance of backends: every requirement is tried, and every violation found."""

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from s2r_cart import Cart
from s2r_toy import COUNT, KEPT, Toy

from s2r_spec.backend import Channel, Effect, EffectParameter, load_backend
from s2r_spec.backend.function import FunctionBackend
from s2r_spec.conformance import check_conformance
from s2r_spec.spec import parse_spec
from s2r_spec.trace import Trace
from tests.cli.conftest import SPEC
from tests.errors import states

PAGE = Path(__file__).parents[1] / "docs" / "how-to" / "effects.md"


def broken(backend):
    return [sentence for check in check_conformance(backend) for sentence in check.violations]


def page_cart():
    names = {}
    exec(re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.S)[0], names)
    return names["Cart"]()


@pytest.mark.parametrize("backend", [Cart(), Toy(), page_cart()], ids=["cart", "toy", "page"])
def test_a_backend_as_the_pages_ask_for_keeps_all(backend):
    found = list(check_conformance(backend))
    assert [p.violations for p in found] == [[]] * len(found)
    assert len(found) == (10 if hasattr(backend, "effects") else 4)


def test_traces_that_are_not_as_declared_are_told():
    class Odd(Cart):
        def rollout(self, params, seed):
            return Cart(self.added).rollout(params, seed)

    first, second, *rest = Cart().channels
    ghost = Channel("ghost", "m", "not there")
    declared = (replace(first, unit="km/h"), replace(second, width=3), *rest, ghost)
    said = broken(Odd(duration=3.0, channels=declared))
    assert len(said) == 4
    for facts in (["v", "m/s", "km/h"], ["v_ref", "1", "3"], ["ghost"], ["1.99 s", "3 s"]):
        assert sum(states(sentence, *facts) for sentence in said) == 1, facts


def test_a_seed_that_does_not_fix_a_trace_is_told():
    class Odd(Cart):
        def rollout(self, params, seed):
            trace = super().rollout(params, seed)
            noisy = {
                name: x + 1e-9 * np.random.default_rng().normal(size=x.shape)
                for name, x in trace.channels.items()
            }
            return Trace(trace.times, noisy, trace.units)

    assert "seed" in broken(Odd())[0]
    assert broken(Odd(deterministic=False)) == []


def test_ends_of_ranges_that_raise_are_told():
    class Odd(Cart):
        def rollout(self, params, seed):
            if params["vd"] > 0.9 or dict(self.chosen()).get("coulomb", {}).get("force", 0.0) > 2.5:
                raise ZeroDivisionError("stuck")
            return super().rollout(params, seed)

    said = broken(Odd())
    assert any(re.match(r"vd = \S+ m/s: ZeroDivisionError: stuck\b", s) for s in said)
    assert any(s.startswith("coulomb with force=3: ZeroDivisionError: stuck") for s in said)


def test_a_backend_whose_default_test_raises_is_not_asked_for_more():
    class Odd(Cart):
        def rollout(self, params, seed):
            raise RuntimeError("no battery")

    (only,) = check_conformance(Odd())
    assert only.violations == ["RuntimeError: no battery"]


@dataclass(frozen=True)
class Careless(Cart):
    """Its effects are there at nominal, act in the order of their adding, and have no name in the hash."""

    order: tuple = ()

    @property
    def model_hash(self):
        return "cart"

    def with_effects(self, values):
        return replace(super().with_effects(values), order=(*self.order, *values))

    def chosen(self):
        return {}

    def rollout(self, params, seed):
        trace = super().rollout(params, seed)
        factor = 1.0 + 1e-6 * sum(k * ord(name[0]) for k, name in enumerate(self.order, 1))
        return Trace(trace.times, {n: factor * x for n, x in trace.channels.items()}, trace.units)


def test_effects_that_break_their_promises_are_told():
    said = broken(Careless())
    for facts in (["viscous and coulomb", "coulomb and viscous"], ["model hash", "viscous"]):
        assert any(states(sentence, *facts) for sentence in said), facts
    assert any(states(sentence, "chosen()", "{}", "viscous", "{'coefficient'") for sentence in said)
    assert any(states(sentence, "viscous", "trace") for sentence in said)


def test_an_effect_that_does_nothing_is_told():
    class Odd(Cart):
        def rollout(self, params, seed):
            kept = tuple((name, value) for name, value in self.added if name != "tilt")
            return Cart(kept).rollout(params, seed)

    (said,) = broken(Odd())
    assert states(said, "tilt")


@dataclass(frozen=True)
class Placed(Cart):
    """A load with a place, declared before its mass: the place acts only where there is some mass."""

    stuck: float = 1.0

    def effects(self):
        place = EffectParameter("place", "m", -0.2, 0.2, 0.0, "normal, 0.05 m")
        mass = EffectParameter("mass", "kg", 0.0, 3.0, 0.0, "half-normal, 0.7 kg")
        return (Effect("load", "inertia", "A load.", (place, mass)),)

    def with_effects(self, values):
        return replace(self, added=tuple(sorted({**dict(self.added), **values["load"]}.items())))

    def chosen(self):
        return {"load": dict(self.added)} if self.added else {}

    def rollout(self, params, seed):
        load = {"place": 0.0, "mass": 0.0} | dict(self.added)
        if load["mass"] and abs(load["place"]) > self.stuck:
            raise ValueError("it topples")
        trace = Cart().rollout(params, seed)
        return Trace(
            trace.times,
            {n: x * (1 + 0.1 * load["mass"] * (1 + load["place"])) for n, x in trace.channels.items()},
        )


def test_a_parameter_that_says_only_how_an_effect_acts_is_tried_where_there_is_some():
    assert broken(Placed()) == []
    said = broken(Placed(stuck=0.1))
    assert len(said) == 2
    assert all(s.startswith("load with mass=1.5, place=") and "ValueError: it topples" in s for s in said)


def test_random_numbers_that_depend_on_effects_are_told():
    class Odd(Cart):
        def rollout(self, params, seed):
            return super().rollout(params, seed + 1000 * bool(self.added))

    said = broken(Odd())
    assert any(states(s, "viscous", "seed") for s in said)


def test_variants_that_are_none_are_told():
    class Varied(Cart):
        def variants(self):
            mute = type(
                "Mute", (Cart,), {"rollout": lambda self, *_: Trace(np.arange(2.0), {"v": np.zeros(2)})}
            )
            heavier = replace(Cart(), added=(("payload", 0.01),))
            return {"itself": Cart(), "mute": mute(), "heavier": heavier}

    said = [s for s in broken(Varied()) if "variant" in s]
    itself, own_hash, mute, mute_hash = said
    assert states(itself, "'itself'", "simulator")
    assert states(own_hash, "'itself'", "model hash")
    assert states(mute, "'mute'", "channels")
    assert states(mute_hash, "'mute'", "model hash")


def test_effects_that_cannot_be_added_together_are_told():
    class Odd(Cart):
        def rollout(self, params, seed):
            if len(self.added) > 1:
                raise ValueError("one at a time")
            return super().rollout(params, seed)

    said = broken(Odd())
    assert any(s.startswith("viscous and coulomb: ValueError: one at a time") for s in said)
    assert "ValueError: one at a time" in said[-1]


def test_where_no_two_rollouts_are_the_same_effects_are_not_blamed():
    class Noisy(Cart):
        def rollout(self, params, seed):
            return super().rollout(params, np.random.default_rng().integers(2**31))

    found = list(check_conformance(Noisy(deterministic=False)))
    assert [p.violations for p in found] == [[]] * 10
    assert any("deterministic" in remark for p in found for remark in p.remarks)


def odd(**more):
    return type("Odd", (Cart,), more)()


FIRST, *REST = Cart().effects()
NO_PRIOR = replace(FIRST, parameters=(replace(FIRST.parameters[0], prior="half normal 1"),))


@pytest.mark.parametrize(
    ("backend", "facts"),
    [
        (odd(rollout=lambda *_: {"v": 1}), ["TypeError", "dict", "Trace"]),
        (odd(with_effects=lambda *_: None), ["backend"]),
        (odd(with_effects=lambda self, values: 1 / 0), ["ZeroDivisionError: division by zero"]),
        (odd(effects=lambda self: (replace(FIRST, parameters=()),)), ["viscous", "parameters"]),
        (odd(effects=lambda self: (FIRST, FIRST)), ["viscous", "2"]),
        (odd(effects=lambda self: (NO_PRIOR, *REST)), ["viscous", "half normal 1"]),
        (odd(chosen=lambda self: {}["x"]), ["KeyError: 'x'"]),
        (
            Cart(parameters=(replace(Cart().parameters[0], default=9.0),)),
            ["vd", "9", "[0, 1.5] m/s"],
        ),
        (odd(residuals=lambda *_: {}["x"]), ["KeyError: 'x'"]),
    ],
)
def test_whatever_a_backend_raises_is_a_sentence(backend, facts):
    violations = broken(backend)
    assert any(states(said, *facts) for said in violations), violations


def test_a_folder_of_recordings_keeps_what_it_can(tmp_path):
    rows = ["id,vd [m/s],acc [m/s^2]"]
    for k, (vd, acc) in enumerate([(0.3, 1.0), (0.9, 3.0), (0.5, 2.0)]):
        trace = Cart(duration=1.0 + 0.2 * k).rollout({"vd": vd, "acc": acc}, k)
        np.savez(tmp_path / f"r{k}.npz", t=100.0 + trace.times, **trace.channels)
        rows.append(f"r{k},{vd},{acc}")
    (tmp_path / "rollouts.csv").write_text("\n".join(rows) + "\n")
    found = list(check_conformance(load_backend(f"log:{tmp_path}")))
    assert [p.violations for p in found] == [[]] * 4, found


def glides(params, seed):
    return Toy().with_duration(1.5).rollout({"vd": 0.1} | dict(params), seed)


def remembers(params, seed):
    trace = glides(params, seed)
    return Trace(trace.times, {"vx": trace["vx"] + 1e-9 * next(COUNT)}, trace.units)


def caches(params, seed):
    trace = glides(params, seed)
    return Trace(trace.times, {"vx": trace["vx"] * KEPT.setdefault("model", 1.0)}, trace.units)


@pytest.mark.parametrize("spec", [None, parse_spec(SPEC.replace("LIMIT", "0.1"), "spec.stl")])
def test_a_function_is_checked_with_a_spec_or_without(spec):
    """Without a spec it has no parameters, no channels and no duration that could be broken."""
    for function in (glides, caches):
        found = list(check_conformance(FunctionBackend(function), spec))
        assert [check.violations for check in found] == [[]] * 4
    (said,) = [
        sentence
        for check in check_conformance(FunctionBackend(remembers), spec)
        for sentence in check.violations
        if "memory" in sentence
    ]
    assert states(said, "vx", "t = 0 s")


def test_a_function_that_lacks_what_the_spec_reads_is_told():
    spec = parse_spec(SPEC.replace("LIMIT", "0.1").replace("vx", "speed"), "spec.stl")
    assert any(
        states(sentence, "speed")
        for check in check_conformance(FunctionBackend(glides), spec)
        for sentence in check.violations
    )


@pytest.mark.parametrize(
    ("habit", "facts"), [("recurrent", ["memory"]), ("first", ["memory"]), ("cached", None)]
)
def test_memory_between_rollouts_is_told(habit, facts):
    KEPT.clear()
    said = broken(Toy(habit))
    assert said == [] if facts is None else states(said[0], "vx", "t = 0 s", *facts)
