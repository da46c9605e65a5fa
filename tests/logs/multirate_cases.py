"""Random formulas over random logs, and how each log is read. A case is made from a seed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tests.logs.multirate import Log, Sent, drawn
from tests.logs.multirate_files import FORMATS
from tests.logs.multirate_formulas import Formula, Leaf, Node, names, windows

Field = tuple[str, str]


@dataclass(frozen=True)
class Case:
    """A log, a formula over signals of it, and how the log is read.

    Args:
        log: the log.
        format: its format.
        rule: "hold" or "linear".
        signals: name in the formula → (topic, field).
        formula: the formula.
        beside: other signals that are read with it.
        clock: name of the signal at whose stamps it is evaluated; None for every instant.
    """

    log: Log
    format: str
    rule: str
    signals: dict[str, Field]
    formula: Formula
    beside: tuple[str, ...] = ()
    clock: str | None = None

    @property
    def spec(self) -> str:
        """The specification."""
        kinds = {name: self.sent(field).kinds[field[1]] for name, field in self.signals.items()}
        lines = [f"signal {name}{' bool' if kind == 'bool' else ''}" for name, kind in kinds.items()]
        return "\n".join([*lines, f"require r: {self.formula.text()}", ""])

    def sent(self, field: Field) -> Sent:
        """Return the topic of a field."""
        return next(sent for sent in self.log.topics if sent.name == field[0])


def case(seed: int) -> Case:
    """Return the case of a seed."""
    rng = np.random.default_rng(seed)
    format_name = str(rng.choice(sorted(FORMATS)))
    form = FORMATS[format_name]
    count = 1 if form.one else int(rng.integers(2, 6)) if rng.random() < 0.9 else 1
    few = 0 if rng.random() < 0.5 else 1 if rng.random() < 0.8 else 2
    faults = [str(fault) for fault in rng.permutation(sorted(form.faults))[:few]]
    rule = "linear" if not form.one and rng.random() < 0.2 else "hold"
    if rule == "linear":
        faults = [fault for fault in faults if "repeated" not in fault]
    log = drawn(rng, count, faults)
    fields = [(sent.name, field) for sent in log.topics for field in sent.kinds]
    if rule == "linear" and form.headers:  # there every field is a floating-point number
        fields = [one for one in fields if log.topics[int(one[0][5:])].kinds[one[1]] != "int"]
    if not fields:
        return case(seed + 10**9)
    most = min(len(fields), int(rng.integers(1, 4)))
    chosen = [fields[k] for k in rng.permutation(len(fields))]
    signals = {f"s{k}": field for k, field in enumerate(chosen)}
    made = Case(log, format_name, rule, signals, Leaf(("s0",), False, "flag", 0.0))
    length = max(max(sent.times) for sent in log.topics)
    unusual = rng.random() < 0.03
    for _ in range(20):
        formula = _formula(rng, made, list(signals)[:most], 0.55 * length, int(rng.integers(1, 3)))
        if unusual or _fits(made, formula):
            break
    rest = [name for name in signals if name not in names(formula)]
    beside = tuple(rest[:2]) if rng.random() < 0.3 else ()
    clock = str(rng.choice(names(formula))) if not form.one and rng.random() < 0.15 else None
    return replace(made, formula=formula, beside=beside, clock=clock)


def _formula(
    rng: np.random.Generator, made: Case, chosen: Sequence[str], budget: float, depth: int
) -> Formula:
    """Return a random formula of so many levels of windows, whose horizon is at most a budget [ms]."""
    shape = rng.choice(["window", "window", "response", "until", "both", "not"])
    most = budget / depth

    least = float(_shortest(made, chosen))

    def inner(part: float) -> Formula:
        if depth > 1 and rng.random() < 0.7:
            return _formula(rng, made, chosen, budget - part, depth - 1)
        return _condition(rng, made, chosen)

    low, high = _window(rng, least, most)
    part = low if high == np.inf else high
    match shape:
        case "window":
            op = str(
                rng.choice(
                    ["always", "always", "eventually"] if depth > 1 or rng.random() < 0.9 else ["once"]
                )
            )
            if depth == 1 and rng.random() < 0.2:
                wrapped = Node(
                    str(rng.choice(["once", "historically"])), (inner(part),), *_window(rng, least, most / 2)
                )
                return Node(op, (wrapped,), low, high)
            return Node(op, (inner(part),), low, high)
        case "response":
            cause: Formula = _leaf(rng, made, chosen)
            cause = Node("rise", (cause,)) if rng.random() < 0.5 else cause
            near, far = _window(rng, least, most / 2)
            answer = Node(
                "eventually" if rng.random() < 0.6 else "always", (_leaf(rng, made, chosen),), near, far
            )
            return Node(
                "always", (Node("->", (cause, answer)),), 0.0, np.inf if rng.random() < 0.5 else most / 2 // 1
            )
        case "until":
            return Node("until", (_condition(rng, made, chosen), inner(part)), low, high)
        case "both":
            parts = (_formula(rng, made, chosen, budget, 1), _formula(rng, made, chosen, budget, 1))
            return Node(str(rng.choice(["and", "or", "->"])), parts)
        case _:
            return Node("not", (Node("eventually", (inner(part),), low, high),))


def _shortest(made: Case, chosen: Sequence[str]) -> float:
    """Return the shortest median interval of some signals [ms]."""
    stamps = [made.sent(made.signals[name]).times for name in chosen]
    return min((float(np.median(np.diff(times))) for times in stamps if len(times) > 1), default=0.0) + 1


def _fits(made: Case, formula: Formula) -> bool:
    """Return whether no window is shorter than a period, or than an interval of messages with common stamps."""
    stamps = [made.sent(made.signals[name]).times for name in names(formula)]
    steps = [np.diff(times) for times in stamps if len(times) > 1]
    if not steps:
        return False
    if len({*stamps}) == 1:
        return all(high - low > steps[0].max() for low, high in windows(formula))
    shortest = min(float(np.median(one)) for one in steps)
    return all(high == low or high - low > shortest for low, high in windows(formula))


def _window(rng: np.random.Generator, least: float, most: float) -> tuple[float, float]:
    """Return the ends of a window [ms], the second at most a budget, or infinite."""
    kind = rng.random()
    least = min(least, most)
    if kind < 0.3 or most < 1:
        return 0.0, np.inf
    length = float(rng.integers(int(least), int(most) + 1))
    if kind < 0.7:
        return 0.0, length
    low = float(rng.integers(0, int(most - length) + 1))
    return (low, low) if kind < 0.75 else (low, low + length)


def _condition(rng: np.random.Generator, made: Case, chosen: Sequence[str]) -> Formula:
    kind = rng.random()
    if kind < 0.6:
        return _leaf(rng, made, chosen)
    if kind < 0.7:
        return Node("not", (_leaf(rng, made, chosen),))
    return Node(str(rng.choice(["and", "or", "->"])), (_leaf(rng, made, chosen), _leaf(rng, made, chosen)))


def _leaf(rng: np.random.Generator, made: Case, chosen: Sequence[str]) -> Leaf:
    one = str(rng.choice(chosen))
    kinds = {name: made.sent(made.signals[name]).kinds[made.signals[name][1]] for name in chosen}
    if kinds[one] == "bool":
        return Leaf((one,), False, "flag", 0.0)
    others = [name for name in chosen if name != one and kinds[name] != "bool"]
    pair = bool(others) and made.rule == "hold" and rng.random() < 0.4
    used = (one, str(rng.choice(others))) if pair else (one,)
    absolute = bool(rng.random() < 0.3)
    op = str(rng.choice(["<=", "<", ">=", ">"]))
    leaf = Leaf(used, absolute, op, 0.0)
    columns = [made.sent(made.signals[name]) for name in used]
    times = sorted({at for sent in columns for at in sent.times})
    found = [leaf.value([_last(made, name, at) for name in used]) for at in times]
    found = [value for value in found if not np.isnan(value)] or [0.0]
    quantile = float(rng.choice([0.0, 0.02, 0.1, 0.5, 0.9, 0.98, 1.0]))
    level = float(np.quantile(found, quantile, method="nearest")) + float(
        rng.choice([-0.125, 0.0, 0.0, 0.125])
    )
    return replace(leaf, level=level)


def _last(made: Case, name: str, at: int) -> float:
    topic, field = made.signals[name]
    sent = made.sent((topic, field))
    found = [value for time, value in zip(sent.times, sent.values[field], strict=True) if time <= at]
    return found[-1] if found else np.nan
