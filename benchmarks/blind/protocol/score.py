"""Score frozen answers against opened labels; every rate with its 95 % interval (Wilson)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.blind.protocol.hashes import read_json
from benchmarks.blind.protocol.unseal import OPENED

SURE = 0.9
MOVES = 3.0
"""An effect moves ρ if it changes ρ by more than this factor times the mean |ρ_real − E ρ_sim| of scatter alone."""
NOTHING = ("no material gap", "no single cause")
"""Verdicts that name no effect, and do not call the cause unknown."""
INSIDE = 0.8
"""Part of the attribution of Δρ that should lie in the window in which a cause acts."""
SMALLEST = 1e-3
"""Smallest probability in the log score; smaller ones count as this."""


@dataclass(frozen=True)
class Rate:
    """A number of cases out of all cases."""

    hits: int
    of: int

    @property
    def value(self) -> float:
        """Return the share; NaN if there are no cases."""
        return self.hits / self.of if self.of else math.nan

    def interval(self) -> tuple[float, float]:
        """Return the 95 % Wilson interval."""
        if not self.of:
            return 0.0, 1.0
        n, p, z = self.of, self.value, 1.96
        middle = (p + z * z / (2 * n)) / (1 + z * z / n)
        half = z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n)) / (1 + z * z / n)
        return max(0.0, middle - half), min(1.0, middle + half)

    def to_json(self) -> dict[str, Any]:
        """Return the share, the counts and the interval."""
        low, high = self.interval()
        return {
            "rate": None if not self.of else round(self.value, 4),
            "hits": self.hits,
            "of": self.of,
            "low": round(low, 4),
            "high": round(high, 4),
        }


Answers = Sequence[tuple[Mapping[str, Any], Mapping[str, Any]]]
"""(label, answer) of each case."""


def load(answers: Path) -> list[tuple[dict[str, Any], dict[str, Any]]]:
    """Return (label, answer) of every case of an opened set."""
    labels = read_json(answers / OPENED)["labels"]
    return [(label, read_json(answers / f"{name}.json")) for name, label in sorted(labels.items())]


def ranked(answer: Mapping[str, Any]) -> list[tuple[frozenset[str], float]]:
    """Return every set with its probability, most probable first, including {"none"}.

    Answers of schema s2r/diagnosis/1 also have a probability of {"unknown"}. In later ones *none of these* is a
    verdict without a probability.
    """
    which = answer["which"]
    found = [(frozenset([name]), float(p)) for name, p in which["posterior"].items()]
    found += [(frozenset(pair["effects"]), float(pair["probability"])) for pair in which["pairs"]]
    return sorted(found, key=lambda item: -item[1])


def truth(label: Mapping[str, Any]) -> frozenset[str]:
    """Return the true answer."""
    if label["kind"] == "null":
        return frozenset(["none"])
    return frozenset(["unknown"]) if label["kind"] == "unknown" else frozenset(label["effects"])


def score(cases: Answers) -> dict[str, Any]:
    """Return every score of a set of cases."""
    known = [(label, a) for label, a in cases if label["kind"] in ("single", "pair", "triple")]
    single = [(label, a) for label, a in cases if label["kind"] == "single"]
    pair = [(label, a) for label, a in cases if label["kind"] == "pair"]
    unknown = [(label, a) for label, a in cases if label["kind"] == "unknown"]
    null = [(label, a) for label, a in cases if label["kind"] == "null"]
    material = [(label, a) for label, a in unknown if _material(a)]
    open_world = [(label, a) for label, a in cases if label["kind"] != "unknown" or _has_unknown(a)]
    claims = [(label, a) for label, a in cases if _has_unknown(a) or a["verdict"] != "none of these"]
    sure = [(label, a) for label, a in claims if ranked(a)[0][1] >= SURE]
    rates = {
        "answered exactly, single": _rate(single, _answered),
        "answered exactly, pair": _rate(pair, _answered),
        "top-1, single effects": _rate(single, _first_right),
        "top-1 among named effects, single": _rate(single, _named_right),
        "top-2, single effects": _rate(single, _among_two),
        "most probable member, single": _rate(single, lambda label, a: {_members(a)[0]} == set(truth(label))),
        "in the answered set, single": _rate(single, lambda label, a: truth(label) <= set(a["which"]["set"])),
        "exact pair first": _rate(pair, _named_right),
        "one of the pair first": _rate(pair, lambda label, a: bool(_named(a)[0] & truth(label))),
        "two likeliest members are the pair": _rate(
            pair, lambda label, a: set(_members(a)[:2]) == truth(label)
        ),
        "unknown with a material gap detected": _rate(
            material, lambda label, a: a["verdict"] == "none of these"
        ),
        "unknown detected, all": _rate(unknown, lambda label, a: a["verdict"] == "none of these"),
        "known effects called unknown": _rate(known, lambda label, a: a["verdict"] == "none of these"),
        "null called anything else": _rate(null, lambda label, a: a["verdict"] not in NOTHING),
        "right where sure": _rate(sure, _first_right),
        "sure": Rate(len(sure), len(cases)),
        "true value in its 90 % interval": _coverage(single),
    }
    if any("background" in label for label, _ in known):
        rates["true value in its 90 % interval, background included"] = _coverage(
            [*known, *null], ("background", "effects")
        )
    if any(a.get("left") for _, a in cases):
        explicable = [(label, a) for label, a in known if _material(a)]
        rates |= {
            "something left of the motion, unknown with a material gap": _rate(material, _strange),
            "something left of the motion, known with a material gap": _rate(explicable, _strange),
        }
    attributed = [(label, a) for label, a in cases if a.get("where") and a["where"].get("delta")]
    if attributed:
        rates |= {
            "attribution sums to Δρ, over time and over channels": _rate(attributed, _adds_up),
            "Δρ within what the two critical predicates allow": _rate(
                [(label, a) for label, a in attributed if _bounded(a)], _between
            ),
        }
    for name, some in (("single", single), ("pair", pair)):
        moving = [(label, a) for label, a in some if _moves(label, a)]
        if moving:
            rates |= {
                f"that moves ρ: first answer right, {name}": _rate(moving, _first_right),
                f"that moves ρ: likeliest named right, {name}": _rate(moving, _named_right),
                f"that moves ρ: likeliest effect right, {name}": _rate(
                    moving, lambda label, a: _members(a)[0] in truth(label)
                ),
            }
    shown = [(label, a) for label, a in single if _moves(label, a) or _isolable(label, a)]
    if shown:
        words = "that moves ρ or is isolable"
        rates |= {
            f"{words}: first answer right, single": _rate(shown, _first_right),
            f"{words}: likeliest effect right, single": _rate(
                shown, lambda label, a: {_members(a)[0]} == set(truth(label))
            ),
            f"{words}: in the answered set, single": _rate(
                shown, lambda label, a: truth(label) <= set(a["which"]["set"])
            ),
        }
    for name, some in (("single", single), ("pair", pair)):
        shown = [(label, a) for label, a in some if _shows(label, a)]
        if shown:
            words = "that moves ρ or is isolable at its size"
            rates |= {
                f"{words}: exactly answered, {name}": _rate(shown, _answered),
                f"{words}: first answer right, {name}": _rate(shown, _first_right),
                f"{words}: likeliest named right, {name}": _rate(shown, _named_right),
                f"{words}: likeliest effects right, {name}": _rate(
                    shown, lambda label, a: set(_members(a)[: len(truth(label))]) == truth(label)
                ),
            }
            if name == "single":
                rates[f"{words}: among the two likeliest answers, single"] = _rate(shown, _among_two)
    inside = [share for label, a in cases if (share := _inside(label, a)) is not None]
    if inside:
        rates[f"at least {INSIDE:.0%} of Δρ in the window in which the effect acts"] = Rate(
            sum(share >= INSIDE for share in inside), len(inside)
        )
    relatives = [(label, a) for label, a in unknown if label.get("relative_of")]
    rates["nearest is the relative"] = _rate(
        relatives, lambda label, a: label["relative_of"] in [n for s, _ in _named(a)[1][:2] for n in s]
    )
    out: dict[str, Any] = {name: rate.to_json() for name, rate in rates.items()}
    out["set size, single (mean)"] = _mean([max(1, len(a["which"]["set"])) for _, a in single])
    out["log score"] = _mean([-math.log(max(_probability(label, a), SMALLEST)) for label, a in open_world])
    out["Brier score"] = _mean([_brier(label, a) for label, a in open_world])
    out["calibration error"] = _calibration(open_world)
    out |= _shrink(single, "single") | _shrink(pair, "pair")
    out["cases"] = len(cases)
    out["confusion"] = _confusion(single)
    return out


def _rate(cases: Answers, right: Any) -> Rate:
    return Rate(sum(bool(right(label, a)) for label, a in cases), len(cases))


def _answered(label: Mapping[str, Any], answer: Mapping[str, Any]) -> bool:
    """Return whether the answer is the truth, not only the most probable set."""
    return frozenset(answer["which"]["answer"]) == truth(label)


def _first_right(label: Mapping[str, Any], answer: Mapping[str, Any]) -> bool:
    return ranked(answer)[0][0] == truth(label)


def _among_two(label: Mapping[str, Any], answer: Mapping[str, Any]) -> bool:
    return truth(label) in [s for s, _ in ranked(answer)[:2]]


def _named_right(label: Mapping[str, Any], answer: Mapping[str, Any]) -> bool:
    return _named(answer)[0] == truth(label)


def _named(answer: Mapping[str, Any]) -> tuple[frozenset[str], list[tuple[frozenset[str], float]]]:
    """Return the most probable set of effects, and all sets ranked, without "none" and "unknown"."""
    found = [(s, p) for s, p in ranked(answer) if not s & {"none", "unknown"}]
    return found[0][0], found


def _members(answer: Mapping[str, Any]) -> list[str]:
    membership = answer["which"]["membership"]
    return sorted(membership, key=lambda name: -membership[name])


def _has_unknown(answer: Mapping[str, Any]) -> bool:
    """Return whether the answer has a probability of a cause outside the catalogue."""
    return "unknown" in answer["which"]["posterior"]


def _material(answer: Mapping[str, Any]) -> bool:
    return bool(answer["how_far"] and answer["how_far"]["material"])


def _strange(label: Mapping[str, Any], answer: Mapping[str, Any]) -> bool:
    """Return whether a remainder of the motion exceeds its tolerance."""
    return any(each["surplus"] > 1.0 for each in answer.get("left", ()))


def _adds_up(label: Mapping[str, Any], answer: Mapping[str, Any]) -> bool:
    """Return whether both attributions of Δρ sum to it within a thousandth."""
    where = answer["where"]
    delta, ended = where["delta"], where.get("ended") or 0.0
    over_time = sum(part["delta"] for part in where["time"])
    over_channels = sum(where["channels"].values())
    return all(abs(total + ended - delta) <= 1e-3 * abs(delta) for total in (over_time, over_channels))


def _bounded(answer: Mapping[str, Any]) -> bool:
    """Return whether predicates bound Δρ, which needs ρ to be a minimum or a maximum of margins."""
    switch = answer["where"].get("switch")
    return switch is not None and switch["bounds"] is not None


def _between(label: Mapping[str, Any], answer: Mapping[str, Any]) -> bool:
    """Return whether Δρ lies between the differences at the two critical predicates."""
    where = answer["where"]
    low, high = where["switch"]["bounds"]
    slack = 1e-9 + 1e-6 * abs(where["delta"])
    # The part of Δρ from an early end was not decided by a predicate.
    decided = where["delta"] - where.get("ended", 0.0)
    return bool(low - slack <= decided <= high + slack)


def _moves(label: Mapping[str, Any], answer: Mapping[str, Any]) -> bool:
    """Return whether the label says that its effects move ρ by more than :data:`MOVES` times its scatter."""
    far = answer["how_far"]
    return bool(far and label.get("moved") is not None and label["moved"] > MOVES * far["floor"])


def _isolable(label: Mapping[str, Any], answer: Mapping[str, Any]) -> bool:
    """Return whether, by the simulator alone, the effect at its typical size differs from every other effect.

    False for an answer without ``isolability``, which schema s2r/diagnosis/1 has alone.
    """
    found = answer["which"].get("isolability")
    if found is None or not truth(label) <= set(found["effects"]):
        return False
    places = [found["effects"].index(name) for name in truth(label)]
    others = [s for k in places for i, s in enumerate(found["sigma"][k]) if i not in places]
    return min(others, default=math.inf) >= float(found["apart"])


def _isolable_at_its_size(label: Mapping[str, Any], answer: Mapping[str, Any]) -> bool:
    """Return whether, by the simulator alone, each effect at its true size differs from every other effect.

    One of its parameters is enough. False for an answer that lacks these sizes.
    """
    told = set()
    for one in answer["which"].get("isolability", {}).get("least", ()):
        value = label["effects"].get(one["effect"], {}).get(one["parameter"])
        low, high = one["below"], one["above"]
        if value is not None and ((low is not None and value <= low) or (high is not None and value >= high)):
            told.add(one["effect"])
    return told == truth(label)


def _shows(label: Mapping[str, Any], answer: Mapping[str, Any]) -> bool:
    """Return whether a single effect moves ρ, or all effects of a case are isolable at their size."""
    return (label["kind"] == "single" and _moves(label, answer)) or _isolable_at_its_size(label, answer)


def _inside(label: Mapping[str, Any], answer: Mapping[str, Any]) -> float | None:
    """Return the share of Δρ of the worst test that lies in the true window; None if there is no window."""
    window, where = (label.get("where") or {}).get("window"), answer.get("where")
    if window is None or not where or not where.get("trace"):
        return None
    begins = where["trace"]["begin"]
    ends = [*begins[1:], math.inf]
    blame = [
        sum(abs(channel["delta"][i]) for channel in where["trace"]["channels"].values())
        for i in range(len(begins))
    ]
    within = sum(
        b for b, begin, end in zip(blame, begins, ends, strict=True) if begin < window[1] and end > window[0]
    )
    return within / sum(blame) if sum(blame) > 0 else None


def _probability(label: Mapping[str, Any], answer: Mapping[str, Any]) -> float:
    return dict(ranked(answer)).get(truth(label), 0.0)


def _brier(label: Mapping[str, Any], answer: Mapping[str, Any]) -> float:
    found = dict(ranked(answer))
    true = truth(label)
    return sum(p * p for s, p in found.items() if s != true) + (1.0 - found.get(true, 0.0)) ** 2


def _calibration(cases: Answers) -> float | None:
    """Return the expected calibration error of the first answer, in ten bins."""
    bins: dict[int, list[tuple[float, bool]]] = {}
    for label, a in cases:
        first, p = ranked(a)[0]
        bins.setdefault(min(int(10 * p), 9), []).append((p, first == truth(label)))
    total = sum(abs(sum(p for p, _ in b) - sum(r for _, r in b)) for b in bins.values())
    return round(total / len(cases), 4) if cases else None


def _coverage(cases: Answers, values_of: Sequence[str] = ("effects",)) -> Rate:
    hits = of = 0
    for label, a in cases:
        for effect, values in (item for name in values_of for item in label.get(name, {}).items()):
            for parameter, value in values.items():
                found = a["which"]["parameters"].get(effect, {}).get(parameter)
                if found is not None and isinstance(value, int | float):
                    of += 1
                    hits += found["low"] <= value <= found["high"]
    return Rate(hits, of)


def _shrink(cases: Answers, kind: str) -> dict[str, Any]:
    """Return the part of the held-out gap above its floor that the patch closed, over cases with a material gap.

    If nothing was named, nothing counts as closed.
    """
    far = [
        a["how_far"] | {"after": (a["which"]["answer"] and a["how_far"]["after"]) or a["how_far"]["before"]}
        for _, a in cases
        if _material(a)
    ]
    tuned = [f for f in far if f.get("tuned")]
    if not far:
        return {}
    above = sum(f["before"]["mean"] - f["floor"] for f in far)
    closed = sum(f["before"]["mean"] - f["after"]["mean"] for f in far)
    shares = sorted(f["share"]["estimate"] for f in far if f["share"])
    oracle = [f["oracle_share"] for f in far if f.get("oracle_share") is not None]
    return {
        f"shrink, {kind}": {
            "cases": len(far),
            "ratio of sums": round(closed / above, 4),
            "median share": round(shares[len(shares) // 2], 4) if shares else None,
            "mean share of oracle": _mean(oracle),
            "ratio of sums, a little of every other effect added": round(
                sum(f["before"]["mean"] - f["tuned"]["mean"] for f in tuned) / above, 4
            )
            if len(tuned) == len(far)
            else None,
        }
    }


def _confusion(cases: Answers) -> dict[str, dict[str, int]]:
    """Return true effect → first answer → count."""
    out: dict[str, dict[str, int]] = {}
    for label, a in cases:
        row = out.setdefault("+".join(sorted(truth(label))), {})
        said = "+".join(sorted(ranked(a)[0][0]))
        row[said] = row.get(said, 0) + 1
    return out


def _mean(values: Sequence[float]) -> float | None:
    return round(sum(values) / len(values), 4) if values else None
