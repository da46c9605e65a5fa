"""What is said while a search runs."""

import re
from dataclasses import replace
from io import StringIO

import pytest
from rich.console import Console

import s2r_spec as s2r
from s2r_spec.certify.bound.kernels import Kernel
from s2r_spec.certify.search.observers import Phase
from s2r_spec.certify.search.plan import rollouts
from s2r_spec.certify.search.search import Query
from s2r_spec.cli.terminal.progress import Live
from s2r_spec.cli.terminal.stages import Stages
from s2r_spec.runs.journal import Record
from tests.errors import states

SEARCH = s2r.Search({"vd": (-0.2, 0.3)}, kernel=Kernel("rbf", 0.2), B=0.5, R=0.02, delta=1e-3, epsilon=0.05)
PHASE = Phase("ρ", "m/s", "toy", {"vd": "m/s"}, None, settings=SEARCH.settings)
CERTIFICATE = replace(SEARCH.certificate(), lower=-0.2, upper=-0.1, rollouts=100)
QUERIES = [Query(7, {"vd": 0.3}, 12), Query(8, {"vd": -0.1}, 3)]


class Clock:
    now = 0.0

    def __call__(self):
        return self.now


def record(rho, failure=None):
    return Record(7, 0, {"vd": 0.3}, 1, rho, failure, None, 0.1)


@pytest.fixture
def clock():
    return Clock()


def live(clock, terminal, quiet=False):
    console = Console(file=StringIO(), force_terminal=terminal, width=120, color_system=None)
    return Live(console, quiet, clock), console


def shown(view, console):
    with console.capture() as capture:
        console.print(view)
    return " ".join(capture.get().split())


def left(words):
    """Return the rollouts and the seconds that are said to be left; None for no time."""
    found = re.search(r"about (\d+) rollouts left(?: \((\d+) (s|min)\))?", words)
    seconds = None if found[2] is None else int(found[2]) * {"s": 1, "min": 60}[found[3]]
    return int(found[1]), seconds


def run(one, clock, old=0, budget=None, certificate=CERTIFICATE, **rule):
    """100 rollouts in 50 s, of which some were on disk before."""
    one.begin(replace(PHASE, budget=budget, settings=replace(SEARCH.settings, budget=budget, **rule)))
    for i in range(100):
        clock.now += 0.5 * (i >= old)
        one.rollout(record(0.1 + 0.001 * i), new=i >= old)
    one.batch(QUERIES, certificate)


def test_the_view_says_what_a_person_in_a_lab_asks(clock):
    one, console = live(clock, terminal=True)
    run(one, clock)
    words = shown(one.view(), console)
    assert states(words, "100 of toy", "50 s")
    # The interval is twice as wide as asked: four times the rollouts if the worst test is known, more if not.
    remaining, seconds = left(words)
    assert 100 < remaining < 700
    assert seconds == pytest.approx(remaining / 2, abs=30)
    assert states(words, "ρ in [+0.1000, +0.2000] m/s", "0.1000 wide, target 0.05")
    assert states(words, "vd = 0.3 m/s (12×)", "vd = -0.1 m/s (3×)", "+0.1990", "+0.1760")
    assert "▁" in words
    assert "█" in words


def test_a_budget_bounds_what_is_left(clock):
    one, console = live(clock, terminal=True)
    run(one, clock, budget=140)
    assert states(shown(one.view(), console), "40 rollouts left", "20 s")


def test_the_batch_that_runs_is_left_also_when_it_is_expected_to_be_the_last(clock):
    one, console = live(clock, terminal=True)
    run(one, clock, certificate=replace(CERTIFICATE, lower=-0.15, upper=-0.0999))
    assert states(shown(one.view(), console), "15 rollouts left", "8 s")


def test_what_an_earlier_process_did_tells_no_pace(clock):
    one, console = live(clock, terminal=True)
    run(one, clock, old=90)
    remaining, seconds = left(shown(one.view(), console))
    assert seconds == pytest.approx(remaining / 2, abs=30)
    one, console = live(clock, terminal=True)
    run(one, clock, old=100)
    assert left(shown(one.view(), console)) == (remaining, None)


def test_before_the_first_rollout_the_plan_is_what_is_left(clock):
    one, console = live(clock, terminal=False)
    one.begin(PHASE)
    one.batch(QUERIES, SEARCH.certificate())
    (line,) = console.file.getvalue().splitlines()
    low, high = rollouts(SEARCH.settings)
    assert low < left(line)[0] < high
    assert left(line)[1] is None


@pytest.mark.parametrize(("rule", "least", "most"), [("decided", 15, 40), ("budget", 400, 400)])
def test_the_stopping_rule_bounds_what_is_left(clock, rule, least, most):
    """The worst mean is 0.149 m/s, and the interval begins at 0.1 m/s: its verdict is known."""
    one, console = live(clock, terminal=True)
    run(one, clock, budget=500, stop=rule)
    assert least <= left(shown(one.view(), console))[0] <= most


def test_the_wait_for_the_first_result_is_not_the_pace(clock):
    """Workers start in it."""
    one, console = live(clock, terminal=True)
    one.begin(PHASE)
    clock.now += 1000.0
    for _ in range(8):
        clock.now += 0.5
        one.rollout(record(0.1))
    one.batch(QUERIES, replace(CERTIFICATE, rollouts=8))
    count, seconds = left(shown(one.view(), console))
    assert seconds == pytest.approx(count / 2, abs=60)


def test_elsewhere_one_line_a_batch(clock):
    one, console = live(clock, terminal=False)
    run(one, clock)
    (line,) = console.file.getvalue().splitlines()
    assert states(
        line,
        "100 rollouts",
        "ρ in [+0.1000, +0.2000] m/s",
        "0.1000 wide, target 0.05",
    )
    assert left(line)[0] > 100
    assert states(line, "vd = 0.3 m/s (12×)", "vd = -0.1 m/s (3×)")


def test_a_crash_is_said_at_once_unless_nothing_is(clock):
    for quiet in (False, True):
        one, console = live(clock, terminal=False, quiet=quiet)
        with one:
            one.begin(PHASE)
            one.rollout(record(-0.5, "crash: no answer within 5 s"))
            one.crash(record(-0.5, "crash: no answer within 5 s"))
        said = console.file.getvalue()
        assert len(said.splitlines()) == (0 if quiet else 1)
        assert quiet or states(said, "rollout 7.0", "vd = 0.3 m/s", "crash: no answer within 5 s", "ρ = -0.5")


def test_the_second_search_of_certify_begins_anew(clock):
    one, console = live(clock, terminal=True)
    run(one, clock)
    settings = replace(SEARCH.settings, budget=40)
    one.begin(replace(PHASE, symbol="Δ", backend="toy:drag", budget=40, settings=settings))
    words = shown(one.view(), console)
    assert states(words, "0 of toy:drag", "40 rollouts left", "0 s")
    assert "+0.1990" not in words


def test_the_screen_is_left_to_an_operator(clock):
    one, console = live(clock, terminal=True)
    with one:
        one.begin(PHASE)
        one.begin(replace(PHASE, attended=True))
        before = console.file.getvalue()
        one.batch(QUERIES, CERTIFICATE)
        one.rollout(record(-0.5, "fall"))
        one.rollout(record(0.1), new=False)
    said = console.file.getvalue().removeprefix(before)
    assert states(said, "rollout 7.0", "vd = 0.3 m/s", "ρ = -0.5000", "fall")
    assert len(said.splitlines()) == 2
    assert "\x1b" not in said


def test_a_stage_is_named_at_once_and_says_each_minute_how_far_it_is():
    now = [0.0]
    out = StringIO()
    stages = Stages(Console(file=out, width=80), quiet=False, clock=lambda: now[0])
    for minutes, done in ((0.0, 0), (0.5, 40), (1.1, 90), (1.2, 95), (2.5, 200)):
        now[0] = 60.0 * minutes
        stages("fitting", done, 0)
    stages("where", 1, 30)
    assert out.getvalue().splitlines() == [
        "fitting",
        "fitting: 90 rollouts so far",
        "fitting: 200 rollouts so far",
        "where: 30",
    ]
