"""ρ by definition: loops over instants, nothing clever, nothing shared with the package.

An instant is a sample; in continuous time it is a point of a lattice, or
"just after" or "just before" one. On the lattice (fine enough for every
crossing of the drawn lines) curves are straight between points, so infima
are at a point or at a limit beside it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from s2r_spec.robustness.evaluation import Evaluation
from s2r_spec.spec import parse_spec
from s2r_spec.trace import Trace
from tests.robustness.drawing import TIMED, Case, Within

STEP, AFTER, BEFORE = 4, 1, 3  # of four parts of a step, two stand for "just" after and before a point


class NoSampleError(Exception):
    """A window lies between two samples of the trace."""


class Definition:
    """ρ at one instant at a time.

    Args:
        places: where the instants are, four to a lattice step; what is no multiple stands for a limit.
        signals: name → value at each instant.
        param: the value of ``p``.
        closed: whether left of an until holds at the witness, too.
        scale: lattice steps in one period, the unit of drawn intervals.
        strict: refuse windows without any instant, as sparse samples have.
    """

    def __init__(
        self,
        places: Sequence[int],
        signals: dict[str, Sequence[float]],
        param: float,
        closed: bool,
        scale: int = 1,
        strict: bool = False,
    ) -> None:
        self.places, self.signals, self.param, self.closed = places, signals, param, closed
        self.scale, self.strict, self.n = STEP * scale, strict, len(places)

    def point(self, t: int) -> bool:
        """Whether an instant is a point, not a limit."""
        return self.places[t] % STEP == 0

    def number(self, node: tuple, t: int) -> float:
        """Return a value at an instant."""
        match node:
            case ("name", "p"):
                return self.param
            case ("name", name):
                return self.signals[name][t]
            case ("num", value):
                return value
            case ("init", inner):
                return self.number(inner, 0)
            case ("overshoot", x, reference):
                difference = self.number(x, t) - self.number(reference, t)
                return difference if self.number(reference, 0) >= 0 else -difference
        parts = [self.number(part, t) for part in node[1:]]
        return {
            "+": lambda a, b: a + b,
            "-": lambda a, b: a - b,
            "*": lambda a, b: a * b,
            "min": min,
            "max": max,
            "norm": math.hypot,
            "abs": abs,
            "sign": lambda a: (a > 0) - (a < 0),
            "minus": lambda a: -a,
        }[node[0]](*parts)

    def window(self, t: int, within: Within | None, sign: int) -> list[int]:
        """Return the instants in t + interval, or t − interval with ``sign`` −1."""
        low, high, low_closed, high_closed = within or (0, None, True, False)
        # the infimum next to a limit does not depend on whether the limit belongs to the window
        low_closed, high_closed = (closed or not self.point(t) for closed in (low_closed, high_closed))
        start, end = low * self.scale, math.inf if high is None else high * self.scale
        found = []
        for w in range(self.n):
            distance = sign * (self.places[w] - self.places[t])
            begins = distance >= start if low_closed else distance > start
            if begins and (distance <= end if high_closed else distance < end):
                found.append(w)
        if self.strict and not found:
            bounds = (self.places[t] + sign * start, self.places[t] + sign * end)
            if all(0 <= bound <= self.places[-1] for bound in bounds):
                raise NoSampleError
        return found

    def until(self, left: list, right: list, t: int, within: Within | None, sign: int = 1) -> float:
        """Sup over witnesses of min(right there, inf of left before); ``sign`` −1 looks into the past."""
        now = within is None or within[0] > 0 or within[2]
        best = -math.inf
        for w in self.window(t, within, sign):
            before = list(range(t, w, sign))
            if self.closed or (not self.point(w) and (w != t or not now)):
                before.append(w)  # a witness just after a point is beside instants that count, too
            best = max(best, min([right[w], *(left[s] for s in before)]))
        return best

    def least(self, x: list, t: int, within: Within | None, sign: int) -> float:
        """Inf over the window."""
        return min([math.inf, *(x[s] for s in self.window(t, within, sign))])

    def edge(self, x: list, t: int) -> float:
        """Now, and not before."""
        if t == 0:
            return -math.inf
        return min(x[t], -x[t - 1] if self.point(t) else -x[t])

    def signal(self, node: tuple) -> list[float]:
        """Return ρ at every instant."""
        every, n = range(self.n), self.n
        match node:
            case ("true",):
                return [math.inf] * n
            case ("false",):
                return [-math.inf] * n
            case ("<" | "<=", a, b):
                return [self.number(b, t) - self.number(a, t) for t in every]
            case (">" | ">=", a, b):
                return [self.number(a, t) - self.number(b, t) for t in every]
            case ("==", a, b):
                return [-abs(self.number(a, t) - self.number(b, t)) for t in every]
            case ("!=", a, b):
                return [abs(self.number(a, t) - self.number(b, t)) for t in every]
        parts = [self.signal(part) for part in node[2 if node[0] in TIMED else 1 :]]
        inner = parts[0]
        match node:
            case ("not", _):
                return [-v for v in inner]
            case ("next", _):
                return [inner[t + 1] if t + 1 < n else -math.inf for t in every]
            case ("prev", _):
                return [inner[t - 1] if t > 0 else -math.inf for t in every]
            case ("rise", _):
                return [self.edge(inner, t) for t in every]
            case ("fall", _):
                return [self.edge([-v for v in inner], t) for t in every]
            case (("always" | "historically") as operator, within, _):
                sign = 1 if operator == "always" else -1
                return [self.least(inner, t, within, sign) for t in every]
            case (("eventually" | "once") as operator, within, _):
                sign = 1 if operator == "eventually" else -1
                return [-self.least([-v for v in inner], t, within, sign) for t in every]
        left, right = parts
        match node[0]:
            case "and":
                return [min(a, b) for a, b in zip(left, right, strict=True)]
            case "or":
                return [max(a, b) for a, b in zip(left, right, strict=True)]
            case "->":
                return [max(-a, b) for a, b in zip(left, right, strict=True)]
            case "<->":
                return [min(max(-a, b), max(a, -b)) for a, b in zip(left, right, strict=True)]
            case "until":
                return [self.until(left, right, t, node[1]) for t in every]
            case "since":
                return [self.until(left, right, t, node[1], sign=-1) for t in every]
            case "release":
                no_left, no_right = [-v for v in left], [-v for v in right]
                return [-self.until(no_left, no_right, t, node[1]) for t in every]
            case "unless":
                _, high, _, high_closed = node[1] or (0, None, True, False)
                reach = (0, high, True, high_closed)
                stays = [self.least(left, t, reach, 1) for t in every]
                return [max(stays[t], self.until(left, right, t, node[1])) for t in every]
        raise AssertionError(node)


class Truth:
    """Whether a formula is true, by the Boolean semantics of STL: and, or, for all, there is. No robustness.

    Args:
        definition: gives numbers and windows.
    """

    def __init__(self, definition: Definition) -> None:
        self.by = definition
        self.n = definition.n

    def number(self, node: tuple, t: int) -> float:
        """Return a value at an instant; at a limit that of the middle between two lattice points."""
        by = self.by
        if by.point(t):
            return by.number(node, t)
        other = t + (1 if by.places[t] % STEP == AFTER else -1)
        return (by.number(node, t) + by.number(node, other)) / 2

    def compares(self, node: tuple, t: int) -> bool:
        """Return what a comparison says at an instant."""
        operator, a, b = node
        left, right = self.number(a, t), self.number(b, t)
        return {
            "<": left < right, "<=": left <= right, ">": left > right, ">=": left >= right,
            "==": left == right, "!=": left != right,
        }[operator]  # fmt: skip

    def until(self, left: list, right: list, t: int, within: Within | None, sign: int = 1) -> bool:
        """There is a witness in the window, and left holds at every instant before it."""
        now = within is None or within[0] > 0 or within[2]
        for w in self.by.window(t, within, sign):
            before = list(range(t, w, sign))
            if self.by.closed or (not self.by.point(w) and (w != t or not now)):
                before.append(w)
            if right[w] and all(left[s] for s in before):
                return True
        return False

    def edge(self, x: list, t: int) -> bool:
        """True now, and not before."""
        return t > 0 and x[t] and not (x[t - 1] if self.by.point(t) else x[t])

    def signal(self, node: tuple) -> list[bool]:
        """Return whether it is true at every instant."""
        every = range(self.n)
        if node[0] in ("true", "false"):
            return [node[0] == "true"] * self.n
        if node[0] in ("<", "<=", ">", ">=", "==", "!="):
            return [self.compares(node, t) for t in every]
        parts = [self.signal(part) for part in node[2 if node[0] in TIMED else 1 :]]
        x = parts[0]
        negated = [[not value for value in part] for part in parts]
        match node[0]:
            case "not":
                return negated[0]
            case "next":
                return [*x[1:], False]
            case "prev":
                return [False, *x[:-1]]
            case "rise":
                return [self.edge(x, t) for t in every]
            case "fall":
                return [self.edge(negated[0], t) for t in every]
            case "always" | "historically":
                sign = 1 if node[0] == "always" else -1
                return [all(x[s] for s in self.by.window(t, node[1], sign)) for t in every]
            case "eventually" | "once":
                sign = 1 if node[0] == "eventually" else -1
                return [any(x[s] for s in self.by.window(t, node[1], sign)) for t in every]
        left, right = parts
        match node[0]:
            case "and":
                return [a and b for a, b in zip(left, right, strict=True)]
            case "or":
                return [a or b for a, b in zip(left, right, strict=True)]
            case "->":
                return [not a or b for a, b in zip(left, right, strict=True)]
            case "<->":
                return [a == b for a, b in zip(left, right, strict=True)]
            case "until":
                return [self.until(left, right, t, node[1]) for t in every]
            case "since":
                return [self.until(left, right, t, node[1], sign=-1) for t in every]
            case "release":
                return [not self.until(*negated, t, node[1]) for t in every]
            case "unless":
                _, high, _, high_closed = node[1] or (0, None, True, False)
                stays = [
                    all(left[s] for s in self.by.window(t, (0, high, True, high_closed), 1)) for t in every
                ]
                return [stays[t] or self.until(left, right, t, node[1]) for t in every]
        raise AssertionError(node)


def halvings(node: tuple) -> int:
    """Return how often lines may cross anew, each time on a lattice twice as fine."""
    none = ["not", "true", "false", "<", "<=", ">", ">=", "num", "name", "+", "minus", "overshoot", "init"]
    new = {"<->": 2, "until": 2, "since": 2, "release": 2, "unless": 3, **dict.fromkeys(none, 0)}
    below = max((halvings(part) for part in node if isinstance(part, tuple) and _is_node(part)), default=0)
    return new.get(node[0], 1) + below


def _is_node(part: tuple) -> bool:
    return bool(part) and isinstance(part[0], str)


def reach(node: tuple) -> int:
    """Return how many periods past an instant bounded windows look; an unbounded one needs its start."""
    below = max((reach(part) for part in node if isinstance(part, tuple) and _is_node(part)), default=0)
    low, high, *_ = node[1] if node[0] in TIMED and node[1] else (0, None)
    match node[0]:
        case "always" | "eventually" | "until" | "release" | "unless":
            return (low if high is None else high) + below
        case "historically" | "once":
            return max(0, below - low)
        case "since":
            return max(0, reach(node[2]), reach(node[3]) - low)
        case "next":
            return 1 + below
    return below


def sample_reach(node: tuple) -> int:
    """As :func:`reach` in samples: an open end does not need the sample on it."""
    below = max(
        (sample_reach(part) for part in node if isinstance(part, tuple) and _is_node(part)), default=0
    )
    within = (node[1] if node[0] in TIMED else None) or (0, None, True, False)
    first = within[0] + (not within[2])
    last = first if within[1] is None else within[1] - (not within[3])
    match node[0]:
        case "always" | "eventually" | "until" | "release" | "unless":
            return last + below
        case "historically" | "once":
            return max(0, below - first)
        case "since":
            return max(0, sample_reach(node[2]), sample_reach(node[3]) - first)
        case "next":
            return 1 + below
    return below


def too_short(case: Case) -> bool:
    """Whether a window of positive length is shorter than the median step: samples say nothing of it."""
    if case.kind in ("hold", "linear") or len(case.ticks) == 1:
        return False
    step = np.median(np.diff(case.ticks))
    return any(0 < high - low < step for low, high in _ends(case.formula))


def _ends(node: tuple) -> list[tuple[int, int]]:
    """Return where the windows of a formula begin and end, in periods, without those that have no end."""
    own = [node[1][:2]] if node[0] in TIMED and node[1] and node[1][1] is not None else []
    return own + [end for part in node if isinstance(part, tuple) and _is_node(part) for end in _ends(part)]


def by_definition(case: Case, meaning: type = Definition) -> list:
    """Return ρ at every sample of a case, or whether it is true (``meaning`` is Truth).

    Raises:
        NoSampleError: the package must refuse it with a sentence.
    """

    def signal(*arguments: Any, **named: Any) -> list:
        definition = Definition(*arguments, **named)
        return (definition if meaning is Definition else meaning(definition)).signal(case.formula)

    ticks, n = list(case.ticks), len(case.ticks)
    x, y = list(case.x), list(case.y)
    closed = case.until == "closed"
    dense = case.kind in ("hold", "linear")
    if case.end == "hold":
        more = reach(case.formula) if dense else sample_reach(case.formula)
        new = [ticks[-1] + more] if dense and more else [ticks[-1] + k + 1 for k in range(more)]
        ticks += new
        x, y = x + x[-1:] * len(new), y + y[-1:] * len(new)
    if not dense:
        places = [STEP * t for t in ticks]
        strict = case.kind == "irregular"
        return signal(places, {"x": x, "y": y}, case.param, closed, strict=strict)[:n]
    scale = 1 if case.kind == "hold" else 2 ** (1 + halvings(case.formula))
    places, signals = lattice(ticks, {"x": x, "y": y}, scale, straight=case.kind == "linear")
    found = signal(places, signals, case.param, closed, scale)
    index = {place: k for k, place in enumerate(places)}
    return [found[index[STEP * t * scale]] for t in ticks[:n]]


def lattice(
    ticks: list[int], samples: dict[str, list[float]], scale: int, straight: bool
) -> tuple[list[int], dict[str, list[float]]]:
    """Return the instants of a trace in continuous time, and each signal at each of them."""
    places: list[int] = []
    signals: dict[str, list[float]] = {name: [] for name in samples}
    for step in range(ticks[-1] * scale + 1):
        for part in (0, AFTER, BEFORE):
            if step == ticks[-1] * scale and part:
                continue
            places.append(STEP * step + part)
            # "just before" the next point is that point as far as a straight line goes
            where = Fraction(step + (part == BEFORE), scale) if straight else Fraction(step, scale)
            i = max(k for k, tick in enumerate(ticks) if tick <= Fraction(step, scale))
            for name, values in samples.items():
                value = values[i]
                if straight and where > ticks[i]:
                    share = (where - ticks[i]) / (ticks[i + 1] - ticks[i])
                    value += float(share) * (values[i + 1] - values[i])
                signals[name].append(value)
    return places, signals


def evaluated(case: Case) -> Evaluation:
    """Return ρ, and whether it is true, at every sample as the package computes it."""
    trace = Trace(case.start + np.array(case.ticks) * float(case.period), {"x": case.x, "y": case.y})
    interpolation = case.kind if case.kind in ("hold", "linear") else "samples"
    return parse_spec(case.text).evaluate(
        trace, "it", {"p": case.param}, interpolation=interpolation, until=case.until, end=case.end
    )
