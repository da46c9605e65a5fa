"""One random log and one random formula: what s2r says, beside what the messages say.

`checked` writes the log of a case, reads it as `s2r monitor` does, and returns the outcome:

    equal      the verdict of the evaluator, and its ρ
    unknown    unknown
    refused    an error with a sentence
    wrong      another verdict, another ρ, an account that does not add up, or a traceback: a fault of s2r
"""

from __future__ import annotations

import itertools
import traceback
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from s2r_spec import parse_spec
from s2r_spec.errors import UsageError
from s2r_spec.logs.topics.join import Joining
from s2r_spec.recordings.log_episodes import EpisodeSettings, LogEpisodes, read_log_episodes
from s2r_spec.spec.monitored import Conventions, Monitored, monitor_requirement
from tests.logs.multirate_cases import Case
from tests.logs.multirate_files import FORMATS
from tests.logs.multirate_formulas import names
from tests.logs.multirate_truth import MS, Dense, Signal, Truth, evaluated, window

WITHOUT_HEADERS = ("ros2.sqlite3", "ros2.mcap", "ros1")
"""Definition: formats whose messages have no header."""
TOLERANCE = 1e-9
"""Tolerance: difference of two ρ of held signals."""
CROSSING = 1e-7
"""Tolerance: difference of two ρ of linear signals, which cross a level between two messages."""


@dataclass(frozen=True)
class Outcome:
    """What became of a case: its status, and the reason."""

    status: str
    why: str = ""
    verdict: bool | None = None


# -- what the messages say ------------------------------------------------------------------------------------------


def known(made: Case) -> dict[str, Signal]:
    """Return the signals that are read, from the messages that were sent, in the order of their times."""
    return {name: _signal(made, name) for name in (*names(made.formula), *made.beside)}


def _signal(made: Case, name: str) -> Signal:
    topic, field = made.signals[name]
    sent = made.sent((topic, field))
    kind = sent.kinds[field]
    read = together(made, name)
    order = sorted(range(len(sent.times)), key=lambda k: (sent.times[k], k))
    rows = [
        (sent.times[k], tuple(sent.values[other][k] for other in read), sent.values[field][k])
        for k in order
        if sent.stamps[k] is not None and not np.isnan(sent.values[field][k])
    ]
    kept = [row for k, row in enumerate(rows) if k == 0 or row[:2] != rows[k - 1][:2]]
    linear = made.rule == "linear" and kind == "real"
    return Signal(tuple(MS * row[0] for row in kept), tuple(row[2] for row in kept), linear)


def _read(made: Case) -> tuple[str, ...]:
    return (*names(made.formula), *made.beside)


def untimed(made: Case) -> bool:
    """Return whether stamps that are read differ from the times of sending."""
    return len({offset for _, offset in _offsets(made)}) > 1


def visible(made: Case) -> bool:
    """Return whether what is read of one topic shows that its stamps are no times.

    They step back, jump, or stand still for more than 1 % of its messages while the values that are read change.
    """
    for name in _read(made):
        topic = made.signals[name][0]
        if len({offset for other, offset in _offsets(made) if other == topic}) < 2:
            continue
        sent = made.sent(made.signals[name])
        rows = [
            (stamp, *(sent.values[field][k] for field in together(made, name)))
            for k, stamp in enumerate(sent.stamps)
            if stamp is not None
        ]
        still = [one[0] == other[0] and one != other for one, other in itertools.pairwise(rows)]
        back = any(one[0] > other[0] for one, other in itertools.pairwise(rows))
        if back or "jump" in made.log.faults or sum(still) > 0.01 * len(rows):
            return True
    return False


def together(made: Case, name: str) -> list[str]:
    """Return the fields that are read from the messages of a signal."""
    topic, field = made.signals[name]
    if made.format in WITHOUT_HEADERS or FORMATS[made.format].joined:  # a topic for each field
        return [field]
    return [made.signals[other][1] for other in _read(made) if made.signals[other][0] == topic]


def _offsets(made: Case) -> set[tuple[str, int]]:
    """Return (topic, how much later a stamp is than the time of sending [ms]) of all that is read."""
    read = {made.signals[name][0] for name in _read(made)}
    return {
        (sent.name, stamp - at)
        for sent in made.log.topics
        if sent.name in read
        for at, stamp in zip(sent.times, sent.stamps, strict=True)
        if stamp is not None
    }


# -- what s2r says --------------------------------------------------------------------------------------------------


def checked(made: Case, folder: Path) -> Outcome:
    """Return the outcome of a case, whose file is written into a folder."""
    try:
        found, verdict = said(made, folder)
    except UsageError as error:
        return Outcome("refused", str(error))
    except Exception:
        return Outcome("wrong", f"traceback: {traceback.format_exc(limit=-6)}")
    return compared(received(made), found, verdict)


def received(made: Case) -> Case:
    """Return a case whose messages are those of the file; without headers, their stamps are the times of receipt.

    A bag is read in the order of receipt, so that nothing tells a recorder whose own clock was set back.
    """
    if made.format not in WITHOUT_HEADERS:
        return made
    topics = []
    for sent in made.log.topics:
        shown = replace(sent, times=tuple(sent.times if None in sent.stamps else sent.stamps))  # type: ignore[arg-type]
        order = sorted(range(len(shown.times)), key=lambda k: (shown.times[k], sent.received[k], k))
        topics.append(shown.picked(order))
    return replace(made, log=replace(made.log, topics=tuple(topics)))


def said(made: Case, folder: Path) -> tuple[LogEpisodes, Monitored]:
    """Return what s2r reads from the file of a case, and its verdict."""
    form = FORMATS[made.format]
    path, columns = form.write(made.log, folder)
    spec = parse_spec(made.spec)
    wanted = dict.fromkeys(_read(made))
    mapped = {name: columns[made.signals[name]] for name in wanted}
    clock = None if made.clock is None else mapped[made.clock]
    chooses = form.joined or made.rule == "linear" or clock is not None
    joining = Joining(clock, made.rule) if chooses else None  # type: ignore[arg-type]
    found = read_log_episodes(
        path, spec.signals, wanted, spec.horizon("r"), EpisodeSettings(mapped, None, joining)
    )
    return found, monitor_requirement(spec, found.episodes[0].trace, "r", {}, Conventions())


def compared(made: Case, found: LogEpisodes, verdict: Monitored) -> Outcome:
    """Return the outcome of a case that was read."""
    if visible(made):
        if verdict.satisfied is None:
            return Outcome("unknown", verdict.text)
        return Outcome("wrong", f"the stamps are no times, but: {verdict.text}", verdict.satisfied)
    signals = known(made)
    if any(one.borderline for one in signals.values()):
        return Outcome("borderline")
    if untimed(made):
        return Outcome("borderline")
    faults = accounted(made, found, verdict, signals)
    if faults:
        return Outcome("wrong", f"{faults}\n{verdict.text}", verdict.satisfied)
    truth = evaluated(made.formula, signals, log_end(made))
    if verdict.satisfied is None:
        needless = truth.truth is not None and truth.complete and truth.whole in (None, truth.truth)
        return Outcome("cautious" if needless else "unknown", f"{verdict.text}\n{truth}")
    differs = differing(made, verdict, truth, signals)
    if differs:
        return Outcome("wrong", f"{differs}\n{verdict.text}\n{truth}", verdict.satisfied)
    return Outcome("equal", verdict=verdict.satisfied)


def differing(made: Case, verdict: Monitored, truth: Truth, signals: dict[str, Signal]) -> str:
    """Return how a verdict differs from what the messages say; "" if it does not."""
    if made.clock is not None and not truth.sampled:  # it is of samples, and must not contradict all messages
        return (
            ""
            if truth.truth == verdict.satisfied
            else (
                f"verdict {verdict.satisfied} at the stamps of {made.clock}, but all messages say {truth.truth}"
            )
        )
    if truth.truth != verdict.satisfied:
        return f"verdict {verdict.satisfied}, but the messages say {truth.truth}"
    if truth.whole is (not verdict.satisfied):
        return f"verdict {verdict.satisfied}, but all messages say {truth.whole}"
    if not truth.complete:
        return f"verdict {verdict.satisfied} on a log that is too short"
    assert verdict.reason is not None
    rho = verdict.reason.rho
    linear = any(signals[name].linear for name in names(made.formula)) and not truth.sampled
    if linear and np.isfinite(rho):
        used = {name: signals[name] for name in names(made.formula)}
        dense = Dense(used, truth.begin, truth.end, _until(made, signals), True)
        above = replace(dense, shift=rho + CROSSING).value(made.formula)
        below = replace(dense, shift=rho - CROSSING).value(made.formula)
        if above[0] > 0 or below[1] < 0:
            return f"ρ = {rho!r}, but the messages say that it is {'more' if above[0] > 0 else 'less'}"
    known = not linear and truth.rho[0] == truth.rho[1] and abs(truth.rho[0]) < np.inf
    return (
        f"ρ = {rho!r}, but the messages say {truth.rho[0]!r}"
        if known and not _near(rho, truth.rho[0])
        else ""
    )


def log_end(made: Case) -> float:
    """Return the last time of any message of the log, also of topics that nobody reads [ticks]."""
    return MS * max(at for sent in made.log.topics for at in sent.times)


def _near(one: float, other: float) -> bool:
    return abs(one - other) <= TOLERANCE


def _until(made: Case, signals: dict[str, Signal]) -> float:
    return window({name: signals[name] for name in names(made.formula)}, log_end(made))[2]


def accounted(made: Case, found: LogEpisodes, verdict: Monitored, signals: dict[str, Signal]) -> str:
    """Return an identity of the account that does not hold; "" if all do."""
    for name in signals:
        account = found.accounts.get(name)
        if account is None:
            return f"no account of {name}"
        if account.messages != account.samples + account.merged + sum(account.dropped.values()):
            return f"account of {name} does not add up: {account}"
        sent = made.sent(made.signals[name])
        if not FORMATS[made.format].joined and account.messages != len(sent.times):
            return f"account of {name}: {account}, but {len(sent.times)} messages were written"
        if "missing" not in made.log.faults and account.samples != len(signals[name].times):
            return f"account of {name}: {account}, but {len(signals[name].times)} messages are distinct"
    sampled = verdict.sampled
    if sampled is None or not sampled.instants or made.clock is not None:
        return ""
    truth_signals = {name: signals[name] for name in names(made.formula)}
    begin, end, _ = window(truth_signals, log_end(made))
    inside = {n: {at for at in one.times if begin <= at <= end} for n, one in truth_signals.items()}
    total = len({begin}.union(*inside.values()))
    for name, one in truth_signals.items():
        instants = sampled.instants[name]
        if instants.own != len(inside[name]):
            return f"{instants} of {name}, but it has {len(inside[name])} messages from {begin} to {end}"
        if instants.own + instants.held + instants.interpolated + instants.missing != total:
            return f"{instants} of {name}, but there are {total} instants"
        before, after = sampled.outside[name]
        if len(set(one.times)) == len(one.times):
            held = begin not in inside[name]
            if before + held + instants.own + after != len(one.times):
                return f"{instants} and {before, after} outside of {name}, but {len(one.times)} messages"
    return ""
