"""Random logs of several topics: s2r says what an evaluator of its own says of all messages, or unknown, or refuses.

The cases are seeds (tests/logs/multirate_cases.py). ``benchmarks/logs/multirate.py`` tries ten thousand of them.
"""

from collections import Counter

import pytest

from s2r_spec import parse_spec
from s2r_spec.logs.topics.join import Joining
from s2r_spec.recordings.log_episodes import EpisodeSettings, read_log_episodes
from s2r_spec.spec.monitored import Conventions, monitor_requirement
from tests.examples import examples
from tests.logs.multirate import Log, Sent
from tests.logs.multirate_cases import case
from tests.logs.multirate_check import checked
from tests.logs.multirate_files import FORMATS
from tests.logs.multirate_formulas import INF, Leaf, Node
from tests.logs.multirate_truth import MS, Signal, evaluated


def test_a_verdict_is_that_of_all_messages_or_unknown_or_refused(tmp_path):
    found, plain, wrong = Counter(), Counter(), []
    for seed in range(examples(1000)):
        made = case(seed)
        folder = tmp_path / str(seed)
        folder.mkdir()
        outcome = checked(made, folder)
        found[outcome.status] += 1
        if not made.log.faults:
            plain[outcome.status] += 1
        if outcome.status == "wrong":
            wrong.append(f"{seed} ({made.format}, {made.rule}, {made.log.faults}): {made.spec}{outcome.why}")
    assert not wrong, "\n\n".join(wrong)
    judged = plain["equal"] + plain["wrong"]
    assert judged >= 0.9 * (sum(plain.values()) - plain["borderline"]), plain
    assert found["equal"] > found["refused"] > 0, found
    assert found["unknown"] > 0, found


# -- the evaluator itself, on cases worked out by hand ----------------------------------------------------------------


def signal(*rows):
    return Signal(tuple(MS * at for at, _ in rows), tuple(float(value) for _, value in rows))


PRESS = signal((0, 0), (305, 1), (310, 0), (2000, 0))
ODOMETRY = signal(*[(at, 0.25) for at in range(0, 2001, 20)])
UP, LOW = Leaf(("s",), False, ">=", 1.0), Leaf(("v",), False, "<=", 0.5)


@pytest.mark.parametrize(
    ("formula", "rho"),
    [
        (Node("and", (Node("eventually", (UP,)), Node("always", (LOW,)))), 0.0),
        (Node("and", (Node("eventually", (UP,), 0, 304), LOW)), -1.0),
        (Node("and", (Node("eventually", (UP,), 305, 305), LOW)), 0.0),
        (Node("and", (Node("always", (UP,), 305, 309), LOW)), 0.0),
        (Node("and", (Node("always", (UP,), 305, 310), LOW)), -1.0),
        (Node("and", (Node("eventually", (Node("always", (UP,), 0, 4),)), LOW)), 0.0),
        (Node("and", (Node("eventually", (Node("always", (UP,), 0, 5),)), LOW)), -1.0),
        (Node("until", (LOW, UP), 0, 400), 0.0),
        (Node("until", (LOW, UP), 311, 400), -1.0),
        (Node("and", (Node("eventually", (Node("rise", (UP,)),)), LOW)), 0.0),
        (Node("and", (Node("always", (Node("once", (UP,), 0, 100),), 305, 409), LOW)), 0.0),
        (Node("and", (Node("always", (Node("once", (UP,), 0, 100),), 305, 410), LOW)), -1.0),
    ],
)
def test_the_evaluator_sees_a_press_between_two_messages(formula, rho):
    assert evaluated(formula, {"s": PRESS, "v": ODOMETRY}).rho == (rho, rho)


def test_the_evaluator_knows_nothing_in_a_silence():
    silent = signal(*[(at, 0.25) for at in range(0, 2001, 20) if not 500 < at < 900])
    always = Node("and", (Node("always", (LOW,)), Leaf(("s",), False, "<=", 5.0)))
    assert evaluated(always, {"s": PRESS, "v": silent}).rho == (-INF, 0.25)
    early = Node("and", (Node("always", (LOW,), 0, 520), Leaf(("s",), False, "<=", 5.0)))
    assert evaluated(early, {"s": PRESS, "v": silent}).truth is True


# -- faults that are open: the smallest logs --------------------------------------------------------------------------


def sent(name, rows, kind="real"):
    times = tuple(at for at, _ in rows)
    return Sent(name, {"f0": kind}, times, times, times, {"f0": tuple(float(value) for _, value in rows)})


def regular(period, value=0.125, first=0, last=2000):
    return [(at, value) for at in range(first, last, period)]


def replaced(rows, at, *values):
    """Return messages with these values at one stamp."""
    return [
        row
        for time, value in rows
        for row in ([(time, v) for v in values] if time == at else [(time, value)])
    ]


def verdict(folder, topics, requirement, name="hdf5", *, read=None, joining=None, when=None):
    """Return the verdict on a requirement of topics that are written into a file, and read as signals."""
    form = FORMATS[name]
    path, columns = form.write(Log(tuple(topics), ()), folder)
    kinds = {topic.name: " bool" if topic.kinds["f0"] == "bool" else "" for topic in topics}
    spec = parse_spec(
        "\n".join([*(f"signal {n}{kind}" for n, kind in kinds.items()), f"require r: {requirement}"])
    )
    wanted = dict.fromkeys(read or kinds)
    joining = Joining() if joining is None and form.joined else joining
    settings = EpisodeSettings({one: columns[one, "f0"] for one in wanted}, None, joining, when)
    found = read_log_episodes(path, spec.signals, wanted, spec.horizon("r"), settings)
    return monitor_requirement(spec, found.episodes[0].trace, "r", {}, Conventions())


def test_the_worst_of_two_values_of_each_of_two_signals_decides(tmp_path):
    x, y = replaced(regular(10, 1.0), 1000, 5.0, 1.0), replaced(regular(10, 4.0), 1000, 4.0, 2.0)
    found = verdict(tmp_path, [sent("x", x), sent("y", y)], "always (x - y <= 2)")
    assert found.satisfied is not True


@pytest.mark.parametrize("name", ["csv.join", "parquet.join"])
def test_a_table_with_empty_cells_keeps_both_values_of_one_stamp(name, tmp_path):
    a = replaced(regular(10), 500, 9.0, 0.125)
    found = verdict(tmp_path, [sent("a", a), sent("b", regular(50, first=3))], "always (a + b <= 5)", name)
    assert found.satisfied is False


@pytest.mark.parametrize("silence", [(500, 1500), (500, 2000)])
def test_a_clock_does_not_hide_a_silence_of_another_topic(silence, tmp_path):
    a = [row for row in regular(20) if not silence[0] < row[0] < silence[1]]
    topics = [sent("a", a), sent("b", regular(20, first=3))]
    found = verdict(tmp_path, topics, "always (a <= 1 and b <= 1)", joining=Joining(clock="b"))
    assert found.satisfied is None


def test_a_clock_serves_a_requirement_of_one_topic_beside_others(tmp_path):
    topics = [sent("a", regular(20)), sent("b", regular(30))]
    found = verdict(tmp_path, topics, "always (a <= 1)", joining=Joining(clock="a"))
    assert found.satisfied is True


def test_a_clock_does_not_hide_what_an_episode_begins_with(tmp_path):
    a = replaced(regular(20, 0.0, last=4000), 1000, 5.0)
    topics = [sent("a", a), sent("b", [(0, 0.0), (1005, 1.0), (3000, 0.0)])]
    requirement = "always[0, 1 s] (a <= 1 and b <= 1)"
    found = verdict(tmp_path, topics, requirement, joining=Joining(clock="a"), when="b > 0.5")
    assert found.satisfied is not True


def test_a_truth_value_is_held_to_the_end_of_a_log_that_is_joined_linearly(tmp_path):
    topics = [sent("a", regular(20)), sent("b", [(0, 1.0), (700, 0.0)], "bool")]
    found = verdict(tmp_path, topics, "always (a <= 1 or b)", "ros2.header", joining=Joining(rule="linear"))
    assert found.sampled is not None
    assert found.sampled.duration == pytest.approx(2.0, abs=0.021)


def test_a_verdict_does_not_depend_on_topics_that_other_requirements_read(tmp_path):
    topics = [sent("a", [(0, 1.0), (300, 2.0), (1000, 1.0)]), sent("c", [(10, 1.0), (310, 2.0), (900, 1.0)])]
    topics.append(sent("other", regular(20, last=5000)))
    alone, beside = (tmp_path / name for name in ("alone", "beside"))
    alone.mkdir(), beside.mkdir()
    found = verdict(alone, topics, "always[0, 2 s] (a + c <= 9)", read=["a", "c"])
    assert verdict(beside, topics, "always[0, 2 s] (a + c <= 9)").satisfied == found.satisfied
