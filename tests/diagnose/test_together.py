"""Which sets of effects the simulator itself is asked about."""

from types import SimpleNamespace

import numpy as np
import pytest

from s2r_spec.diagnose import together as module
from s2r_spec.diagnose.judge import Sets
from s2r_spec.diagnose.together import Together, together

BEFORE = {
    (0, 1, 2): 2.0,
    (0, 2): 1.9,
    (0,): 1.8,
    (): -5.0,
    (1,): -4.0,
    (2,): -4.0,
    (0, 1): -1.0,
    (1, 2): -4.0,
}
"""What the linear evidence says: that of the bank's derivatives, where the simulator is dear."""


def sets(logs):
    weight = np.exp(list(logs.values()))
    return Sets(tuple(logs), weight / weight.sum())


@pytest.mark.parametrize("dear", [True, False])
def test_an_effect_is_named_beside_others_only_if_the_simulator_was_asked_without_it(monkeypatch, dear):
    simulated = BEFORE | {(0, 2): -5.0, (0,): -6.0, (0, 1): 2.5}
    monkeypatch.setattr(
        module,
        "_weighed",
        lambda state, fits: Together(
            sets(BEFORE | {s: simulated[s] for s in fits}), np.zeros(len(BEFORE)), dict(fits), 1.0
        ),
    )
    looked = []
    state = SimpleNamespace(
        sets=sets(BEFORE),
        found=SimpleNamespace(logs=np.zeros(len(BEFORE))),
        temperature=1.0,
        simulator=SimpleNamespace(dear=dear),
        beside=lambda members: looked.append(members) or SimpleNamespace(cost=-simulated[members], rest=None),
        missing=lambda rest, members: [],
    )
    found = together(state, lambda done, of: None)
    named = found.sets.ranked()[0][0]
    assert named == (0, 1)
    assert {(0,), (1,)} <= set(found.fits)
    assert len(looked) == len(set(looked))
