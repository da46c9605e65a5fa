"""A declared effect changes the named components of a field, in a model of any kind."""

import pickle
from dataclasses import dataclass

import numpy as np
import pytest

from s2r_spec.backend import EffectParameter
from s2r_spec.effects import ModelEffect, add_effects, adds, choose, limits, scales, sets


@dataclass(frozen=True)
class Model:
    gain: float = 2.0
    damping: tuple[float, ...] = (1.0, 2.0, 3.0, 4.0)


def number(name, nominal):
    return EffectParameter(name, "", -9.0, 9.0, nominal, "uniform")


@pytest.mark.parametrize(
    ("change", "before", "after"),
    [
        (adds("f"), 0.1, 0.1 + 0.7),
        (scales("f"), 0.1, 0.1 * 0.7),
        (limits("f"), 0.1, 0.1),
        (limits("f"), 3, 0.7),
        (sets("f"), 0.1, 0.7),
        (adds("f"), (1.0, 2.0), (1.7, 2.7)),
        (scales("f", 1), (1.0, 2.0), (1.0, 1.4)),
        (adds("f", [0, 2]), (1.0, 2.0, 3.0), (1.7, 2.0, 3.7)),
        (sets("f", slice(1, None, 2)), (1.0, 2.0, 3.0, 4.0), (1.0, 0.7, 3.0, 0.7)),
    ],
)
def test_a_change_is_of_the_named_components(change, before, after):
    found = change.of(before, 0.7)
    assert found == after
    assert type(found) is type(after)


def test_a_change_of_an_array_leaves_the_old_one():
    friction = np.ones((4, 3))
    slippery = scales("friction", ([1, 3], 0)).of(friction, 0.5)
    assert slippery[:, 0].tolist() == [1.0, 0.5, 1.0, 0.5]
    assert (slippery[:, 1:] == 1.0).all()
    assert (friction == 1.0).all()


def test_effects_are_added_to_a_model():
    catalogue = (
        ModelEffect("weak", "", "", (number("factor", 1.0),), (scales("gain"),)),
        ModelEffect("stiff", "", "", (number("one", 0.0), number("all", 0.0)), (adds("damping", 1), adds("damping"))),
    )  # fmt: skip
    choice = choose("toy", catalogue, (), {"weak": {"factor": 0.5}, "stiff": {"all": 1.0, "one": 3.0}})
    assert add_effects(Model(), catalogue, choice) == Model(1.0, (2.0, 6.0, 4.0, 5.0))
    assert add_effects(Model(), catalogue, choose("toy", catalogue, (), {"stiff": {}})) == Model()
    assert pickle.loads(pickle.dumps(catalogue)) == catalogue
