"""Which sets of effects the simulator itself is asked about."""

from itertools import combinations
from math import comb
from types import SimpleNamespace

import numpy as np
import pytest

from s2r_spec.diagnose import together as module
from s2r_spec.diagnose.judge import WEIGHTS, Sets
from s2r_spec.diagnose.practice import KINDS
from s2r_spec.diagnose.together import Together, corrected, together

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
        lambda state, fits, grown, told: Together(
            sets(BEFORE | {s: simulated[s] for s in fits}), np.zeros(len(BEFORE)), dict(fits), 1.0
        ),
    )
    looked = []
    state = SimpleNamespace(
        sets=sets(BEFORE),
        found=SimpleNamespace(logs=np.zeros(len(BEFORE))),
        temperature=1.0,
        simulator=SimpleNamespace(dear=dear),
        by_bank=False,
        beside=lambda members: looked.append(members) or SimpleNamespace(cost=-simulated[members], rest=None),
        missing=lambda rest, members: [],
        judge=SimpleNamespace(effects=("a", "b", "c")),
    )
    found = together(state, lambda done, of: None)
    named = found.sets.ranked()[0][0]
    assert named == (0, 1)
    assert {(0,), (1,)} <= set(found.fits)
    assert len(looked) == len(set(looked))


def machine(monkeypatch, causes, effects, wrong=2.0):
    """Return a state of which every effect that is a cause pays, any other costs; four and more are not in the list."""
    few = [s for size in range(4) for s in combinations(range(effects), size)]
    looked = []

    def log(members):
        return 3.5 * len(set(members) & set(causes)) - wrong * len(set(members) - set(causes))

    def weighed(state, fits, grown, told):
        known = dict.fromkeys((*few, *fits, *grown))
        return Together(sets({s: log(s) for s in known}), np.zeros(len(known)), dict(fits), 1.0)

    monkeypatch.setattr(module, "_weighed", weighed)
    return looked, SimpleNamespace(
        sets=sets({s: log(s) for s in few}),
        found=SimpleNamespace(logs=np.zeros(len(few))),
        temperature=1.0,
        simulator=SimpleNamespace(dear=False),
        by_bank=False,
        beside=lambda members: looked.append(members) or SimpleNamespace(cost=-log(members), rest=None),
        missing=lambda rest, members: [],
        judge=SimpleNamespace(effects=tuple("abcdefgh"[:effects])),
    )


@pytest.mark.parametrize("causes", [(0, 2, 3, 5), (0, 1, 2, 4, 6), (0, 1, 2, 3, 4, 5)])
def test_a_machine_with_more_than_three_effects_has_all_of_them_named(monkeypatch, causes):
    looked, state = machine(monkeypatch, causes, 8)
    found = together(state, lambda done, of: None)
    assert found.sets.ranked()[0][0] == causes
    assert causes in found.fits
    assert len(looked) == len(set(looked))
    assert all(tuple(k for k in causes if k != left) in found.fits for left in causes)


@pytest.mark.parametrize(("causes", "wrong", "looks"), [((2,), 4.0, 1), ((0, 2, 3, 5), 2.0, module.FEW)])
def test_where_the_bank_stands_for_the_simulator_few_sets_are_simulated_and_sets_still_grow(
    monkeypatch, causes, wrong, looks
):
    looked, state = machine(monkeypatch, causes, 8, wrong)
    state.by_bank, state.simulator.dear = True, True
    found = together(state, lambda done, of: None)
    assert found.sets.ranked()[0][0] == causes
    # One that is far less likely than the first would not become the first by any look.
    assert len(looked) == len(found.fits) == looks


EVERY = tuple(s for size in range(4) for s in combinations(range(3), size))


def heard(cost, expected, logs=None, warmth=10.0):
    """Return set → by how much a look at some changed its log evidence."""
    before = np.zeros(len(EVERY)) if logs is None else logs
    after = corrected(EVERY, before, cost, dict.fromkeys(cost, expected), warmth)
    return dict(zip(EVERY, after - before, strict=True))


def test_sets_that_were_not_simulated_err_as_those_with_one_effect_more_or_less_that_cost_more():
    found = heard({(0,): 90.0, (1, 2): 110.0}, 100.0)
    assert found[(0,)] == 5.0
    assert found[(1, 2)] == -5.0
    assert found[(1,)] == found[(2,)] == found[(0, 1, 2)] == -5.0
    assert (
        found[(0, 1)] == found[(0, 2)] == found[()] == 0.0
    )  # that another costs little says nothing of these
    assert heard({(0,): 90.0}, 100.0) == dict.fromkeys(EVERY, 0.0)  # all err alike, for all that is known


def test_an_effect_gains_no_more_than_the_simulator_found():
    cost = {(0,): 100.0, (0, 1): 96.0}
    logs = np.array([40.0 if 1 in s else 0.0 for s in EVERY])
    after = dict(zip(EVERY, corrected(EVERY, logs, cost, {(0,): 160.0, (0, 1): 96.0}, 1.0), strict=True))
    assert after[(0, 1)] - after[(0,)] == pytest.approx(2.0)
    assert after[(0, 1, 2)] - after[(0, 2)] == pytest.approx(5.0)  # and not 40


def test_a_fit_that_costs_more_than_that_of_fewer_effects_stopped_in_a_wrong_valley():
    after = heard({(0,): 100.0, (0, 1): 400.0, (2,): 100.0}, 100.0)
    assert after[(0, 1)] == after[(0,)] == after[(2,)]


def test_a_look_lowers_and_raises_no_more_than_is_believed():
    after = heard({(0,): 100.0, (1,): 1e6, (2,): -1e6}, 100.0)
    assert after[(1,)] == -module.HEARD[0] * 10.0
    assert after[(2,)] == module.HEARD[1] * 10.0
    assert not corrected(EVERY, np.zeros(8), {}, {}, 1.0).any()


def test_what_imitates_one_of_four_effects_is_weighed_in_its_place(monkeypatch):
    _, state = machine(monkeypatch, (0, 2, 3, 7), 8)
    found = together(state, lambda done, of: None)
    known = set(found.sets.members)
    swapped = {tuple(sorted({0, 2, 3, 7} - {out} | {new})) for out in (0, 2, 3, 7) for new in (1, 4, 5, 6)}
    assert swapped <= known
    assert not [s for s in known if len(s) == 4 and len(set(s) & {0, 2, 3, 7}) < 2]


def test_no_set_is_larger_than_the_largest_and_none_grows_that_does_not_pay(monkeypatch):
    looked, state = machine(monkeypatch, range(8), 8)
    found = together(state, lambda done, of: None)
    assert len(found.sets.ranked()[0][0]) == module.LARGEST
    looked, state = machine(monkeypatch, (1, 2), 8)
    together(state, lambda done, of: None)
    assert max(map(len, looked)) <= module.SEARCHED
    looked, state = machine(monkeypatch, (0, 1, 2), 3)  # a catalogue that has no more
    assert together(state, lambda done, of: None).sets.ranked()[0][0] == (0, 1, 2)


def test_more_effects_than_were_counted_cost_as_much_as_the_last():
    known = WEIGHTS.penalty
    step = known[3] - known[2]
    np.testing.assert_allclose(
        WEIGHTS.penalties(np.arange(6), WEIGHTS.catalogue, 0.5),
        [*known, known[3] + step, known[3] + 2.0 * step],
    )


@pytest.mark.parametrize("effects", [2, 4, 12, 30])
def test_the_sets_of_a_size_are_as_likely_together_in_a_small_catalogue_as_in_a_large_one(effects):
    size = np.arange(1, min(effects, 4) + 1)

    def together_of(catalogue, trust):
        count = np.array([comb(catalogue, n) / catalogue for n in size])
        return np.log(count) - WEIGHTS.penalties(size, catalogue, trust)

    usual = together_of(WEIGHTS.catalogue, None)
    np.testing.assert_allclose(together_of(effects, None), usual, atol=1e-12)
    # Networks bring their part of it.
    lost, less = (WEIGHTS.penalties(size, effects, trust) for trust in (None, 0.4))
    known = WEIGHTS.penalties(size, WEIGHTS.catalogue, None)
    np.testing.assert_allclose(less - known, 0.6 * (lost - known), atol=1e-12)


def test_where_networks_abstain_no_effect_is_as_likely_as_in_practice():
    for effects in (3, 12):
        none, single = -WEIGHTS.penalties(np.arange(2), effects, None)
        assert np.exp(none) / (effects * np.exp(single)) == pytest.approx(KINDS[0] / KINDS[1])
    assert WEIGHTS.penalties(np.arange(2), 12, 0.4).tolist() == [0.0, 0.0]
