"""Campaigns: how a budget is shared, what a folder keeps, and what happens when a protocol cannot run."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

import s2r_spec as s2r
from s2r_spec.diagnose.data.campaign import campaign, plan
from s2r_spec.diagnose.data.protocols import allowed_experiments, next_words
from s2r_spec.diagnose.data.rollouts import as_experiment, recorded_rollouts
from s2r_spec.diagnose.data.space_filling import representative, star
from s2r_spec.diagnose.data.split import split
from s2r_spec.diagnose.simulator.experiments import Experiment
from s2r_spec.errors import UsageError
from tests.diagnose.data.pointer import AMPLITUDE, PROTOCOLS, SPEC, TIMES, Pointer, bench_of, limited
from tests.errors import naming, states

BENCH = bench_of()
TESTS = representative(star(SPEC.space), SPEC.space)
BOTH = allowed_experiments(Pointer(), Pointer())[0]


class KilledError(BaseException):
    """Nothing catches it, as nothing catches a kill."""


def alternate(train, dropped):
    """Choose protocols and tests in turn, at values that depend on the data so far."""
    size = float(np.round(0.2 + 0.5 * abs(train.tests[-1][1]["v"]).mean(), 6))
    free = [p.name for p in PROTOCOLS if p.name not in dropped]
    if len(train.protocols) % 2 and free:
        return Experiment(free[0], (("amplitude", size),))
    return as_experiment(BENCH, {"vd": size + 0.01 * len(train.tests)})


def content(rollouts):
    """Return everything in the rollouts, bit for bit."""
    runs = [*rollouts.tests, *rollouts.protocols]
    return [(e, {n: x.tobytes() for n, x in t.channels.items()}, t.times.tobytes(), dict(t.units), dict(t.meta))
            for e, t in runs], rollouts.notes  # fmt: skip


def test_a_budget_has_held_out_tests_a_screen_and_a_rest_to_choose():
    made = plan(BENCH, TESTS, BOTH, 30)
    assert (made.held_out, made.chosen, len(made.steps)) == (6, 14, 16)
    held, screen = made.steps[:6], Counter(made.steps[6:])
    assert len(set(held)) == 6
    assert not set(held) & set(screen)
    assert screen == Counter(dict.fromkeys((*(as_experiment(BENCH, t) for t in TESTS), *BOTH), 2))
    short = plan(BENCH, TESTS, BOTH, 13)
    assert (short.held_out, short.chosen) == (6, 0)
    assert [Counter(short.steps[6:])[e] for e in dict.fromkeys(short.steps[6:])] == [2, 2, 1, 1, 1]
    assert (plan(BENCH, TESTS, BOTH, 8).held_out, plan(BENCH, TESTS, BOTH, 9).held_out) == (3, 4)
    with pytest.raises(UsageError, match=naming("7", "8", "--budget", "--protocols")):
        plan(BENCH, TESTS, BOTH, 7)


def test_without_protocols_the_budget_goes_to_tests_that_fill_the_space():
    made = plan(BENCH, TESTS, (), 30)
    assert (made.held_out, made.chosen) == (0, 0)
    assert sorted(Counter(made.steps).values()) == [1] * 12 + [3] * 6
    found = campaign(BENCH, Pointer(), made, 1)
    parts = split(found, 1)
    held = {t["vd"] for t, _ in parts.held_out}
    assert len(held) == 5
    assert not held & {t["vd"] for t, _ in parts.train.tests}


@pytest.mark.parametrize("machine", [Pointer(falls="coast"), Pointer(refuses="chirp")])
def test_a_campaign_that_is_killed_anywhere_ends_with_the_same_rollouts(tmp_path, machine):
    made = plan(BENCH, TESTS[:1], BOTH, 14)
    chosen = []

    def choose(train, dropped):
        chosen.append(alternate(train, dropped))
        return chosen[-1]

    machine.ran.clear()
    whole = campaign(BENCH, machine, made, 3, choose, tmp_path / "whole")
    assert content(whole) == content(campaign(BENCH, machine, made, 3, alternate))
    runs, choices = machine.ran[: len(machine.ran) // 2], list(chosen)
    for kill in range(len(runs)):
        folder = tmp_path / f"killed{kill}"

        class Killed(Pointer):
            def _trace(self, v, seed, meta=None):
                if len(self.ran) == kill:  # noqa: B023
                    raise KilledError
                return super()._trace(v, seed, meta)

        chosen.clear()
        with pytest.raises(KilledError):
            campaign(BENCH, Killed(falls=machine.falls, refuses=machine.refuses), made, 3, choose, folder)
        rest = replace(machine, ran=[])
        again = campaign(BENCH, rest, made, 3, choose, folder)
        assert content(again) == content(whole)
        assert rest.ran == runs[kill:]
        assert chosen == choices, kill
        assert (folder / "rollouts.csv").read_text() == (tmp_path / "whole" / "rollouts.csv").read_text()


def test_the_folder_of_a_campaign_is_a_folder_of_logs(tmp_path):
    machine = limited(Pointer("cm/s", falls="coast"), 0.5)
    protocols, _ = allowed_experiments(Pointer(), machine)
    assert protocols[0] == Experiment("chirp", (("amplitude", 0.5),))
    found = campaign(BENCH, machine, plan(BENCH, TESTS, protocols, 18), 3, alternate, tmp_path)
    read = recorded_rollouts(BENCH, s2r.load_backend(f"log:{tmp_path}"))
    assert found.by_experiment(BENCH).keys() >= {as_experiment(BENCH, t) for t in TESTS} | set(protocols)
    assert [e for e, _ in read.protocols] == [e for e, _ in found.protocols]
    for (test, trace), (other, kept) in zip(read.tests, found.tests, strict=True):
        assert test == pytest.approx(other)
        np.testing.assert_array_equal(trace["v"], kept["v"])
    assert all(abs(t["v"]).max() < 2.0 and t.units["v"] == "m/s" for _, t in (*read.tests, *read.protocols))
    assert "vd [cm/s]" in (tmp_path / "rollouts.csv").read_text()


def test_a_run_that_was_killed_between_trace_and_row_gets_its_row(tmp_path):
    made = plan(BENCH, TESTS, BOTH, 16)
    campaign(BENCH, Pointer(), made, 0, folder=tmp_path)
    table = tmp_path / "rollouts.csv"
    whole = table.read_text()
    table.write_text("".join(whole.splitlines(keepends=True)[:-1]))
    again = Pointer()
    campaign(BENCH, again, made, 0, folder=tmp_path)
    assert (table.read_text(), again.ran) == (whole, [])


@pytest.mark.parametrize(
    ("changes", "count", "kept"), [({"refuses": "chirp"}, 3, 0), ({"falls": "chirp"}, 3, 1), ({}, 4, 2)]
)
def test_a_protocol_that_cannot_run_is_left_out_with_a_note(changes, count, kept):
    found = campaign(BENCH, Pointer(**changes), plan(BENCH, TESTS, BOTH, 16), 0)
    assert Counter(e.protocol for e, _ in found.protocols) == Counter({"chirp": kept, "coast": 2})
    assert len(found.notes) == (1 if changes else 0)
    assert all(states(note, "chirp", "fall" if "falls" in changes else "too short") for note in found.notes)


def test_a_folder_of_another_campaign_is_refused(tmp_path):
    made = plan(BENCH, TESTS, BOTH, 16)
    campaign(BENCH, Pointer(), made, 0, folder=tmp_path / "one")
    for other in (
        plan(BENCH, TESTS, BOTH, 16, seed=1),
        plan(BENCH, TESTS, BOTH[1:], 16),
        plan(BENCH, (), (), 16),
    ):
        with pytest.raises(UsageError, match=naming("log:", "--real")):
            campaign(BENCH, Pointer(), other, 0, folder=tmp_path / "one")
    (tmp_path / "one" / "campaign.json").write_text('{"schema": "s2r.campaign/1", "steps": [{}]}')
    with pytest.raises(UsageError, match=naming("campaign.json", "log:")):
        campaign(BENCH, Pointer(), made, 0, folder=tmp_path / "one")
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / "rollouts.csv").write_text("id,vd\n")
    with pytest.raises(UsageError, match=naming("campaign.json", "log:")):
        campaign(BENCH, Pointer(), made, 0, folder=tmp_path / "logs")


def test_a_machine_with_an_operator_is_refused():
    exclusive = Pointer()
    object.__setattr__(exclusive, "exclusive", True)
    with pytest.raises(UsageError, match=naming("operator", "log:")):
        campaign(BENCH, exclusive, plan(BENCH, TESTS, BOTH, 16), 0)


def test_which_protocols_are_allowed():
    machine = replace(Pointer(), offered=(*PROTOCOLS, replace(PROTOCOLS[0], name="step")))
    both, notes = allowed_experiments(Pointer(), machine)
    assert [e.protocol for e in both] == ["chirp", "coast"]
    assert states(notes[0], "step")
    assert [e.protocol for e in allowed_experiments(Pointer(), machine, ["coast", "chirp"])[0]] == [
        "chirp",
        "coast",
    ]
    assert allowed_experiments(Pointer(), machine, ()) == ((), ())
    for name, where in (("chrip", machine), ("step", machine), ("chirp", replace(machine, offered=()))):
        with pytest.raises(UsageError, match=naming(f"'{name}'", "chirp") if where.offered else "chirp"):
            allowed_experiments(Pointer(), where, [name])
    other = replace(PROTOCOLS[0], parameters=(replace(AMPLITUDE, unit="m"),))
    assert states(allowed_experiments(Pointer(), replace(machine, offered=(other,)))[1][0], "chirp", "units")


def test_the_next_experiment_in_words_and_as_a_file(tmp_path):
    units, test = {"vd": "m/s"}, Experiment.test({"vd": 0.3})
    assert states(next_words(test, units, Pointer()), "vd = 0.3 m/s", "rollouts.csv")
    assert states(next_words(test, units, Pointer(), replayed=True), "commands", "vd = 0.3 m/s")
    half = Experiment("coast", (("amplitude", 0.5),))
    assert states(
        next_words(half, units, Pointer(), tmp_path / "a.csv"), "coast", "amplitude = 0.5", "hits the end"
    )
    assert not list(tmp_path.iterdir())

    class Robot(Pointer):
        def playable(self, protocol, params):
            q = params["amplitude"] * TIMES[:, None]
            return s2r.Trace(TIMES, {"q": q, "dq": q, "kp": TIMES, "kd": TIMES}, {"q": "rad"})

    words = next_words(half, units, Robot(), tmp_path / "coast.csv")
    assert states(words, "coast", "10 ms", "hits the end", "amplitude = 0.5")
    assert s2r.read_trace(tmp_path / "coast.csv")["q_0"][-1] == 0.5
    # A machine whose defaults differ plays what was simulated.
    other = replace(PROTOCOLS[0], parameters=(replace(AMPLITUDE, default=0.75),))
    path, usual = tmp_path / "usual.csv", Experiment(other.name)
    assert states(next_words(usual, units, Pointer(), path, machine=Robot(offered=(other,))), "usual.csv")
    assert s2r.read_trace(path)["q_0"][-1] == AMPLITUDE.default
