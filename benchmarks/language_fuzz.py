"""Random bytes and broken specifications: nothing but the language's own error may come out.

    python benchmarks/language_fuzz.py [count]

A third of the texts are random bytes, a third random tokens, a third good
specifications with a few characters changed, removed or moved. What parses is
formatted as well. Writes language_fuzz.txt.
"""

from __future__ import annotations

import json
import random
import sys
import time
from collections import Counter
from pathlib import Path

from machine import describe

from s2r_spec.lang.diagnostics import SpecError
from s2r_spec.lang.printing import format_text
from s2r_spec.spec import parse_spec

ROOT = Path(__file__).parents[1]
GOOD = [
    path.read_text(encoding="utf-8")
    for folder in ("specs", "tests/specs/good", "tests/specs/bad")
    for path in sorted((ROOT / folder).glob("*.stl"))
]
TOKENS = [
    "signal", "param", "const", "let", "require", "certify", "import", "bool", "always", "until", "since",
    "not", "in", "inf", "x", "p", "vx", "{m/s}", "{}", "1", "0.5e3", "[", "]", "(", ")", ",", ":", ":=",
    "=", "<=", "==", "->", "-", "^", "*", "/", "#", "$", "\n", "_", "[]", "<>", "G", "U", "ms", "delta",
    "kernel", "rbf(", "mean(", "if(", "é", "'", '"a"', "\x00", "{kg^-3}", "1e999",
]  # fmt: skip


def text(rng: random.Random) -> str:
    match rng.randrange(3):
        case 0:
            return rng.randbytes(rng.randrange(80)).decode("utf-8", "replace")
        case 1:
            return " ".join(rng.choices(TOKENS, k=rng.randrange(30)))
    good = list(rng.choice(GOOD))
    for _ in range(rng.randrange(1, 6)):
        place = rng.randrange(len(good) + 1)
        match rng.randrange(4):
            case 0:
                good[place:place] = rng.choice(TOKENS)
            case 1:
                del good[place : place + rng.randrange(1, 8)]
            case 2:
                good[place : place + 1] = chr(rng.randrange(32, 0x250))
            case 3:
                other = rng.randrange(len(good) + 1)
                good[place:place] = good[other : other + 12]
    return "".join(good)


def outcome(spec: str) -> str:
    """Return what came out; anything but the first three is a bug."""
    try:
        parse_spec(spec)
        again = format_text(spec)
        return "good" if format_text(again) == again else "formatting is not idempotent"
    except SpecError as error:
        str(error)
        return "mistakes"
    except Exception as error:
        return f"{type(error).__name__}: {error}"


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000
    rng, outcomes, examples = random.Random(0), Counter[str](), {}
    start = time.perf_counter()
    for _ in range(count):
        spec = text(rng)
        what = outcome(spec)
        outcomes[what] += 1
        if what not in ("good", "mistakes"):
            examples.setdefault(what, spec)
    record = {
        "machine": describe("lark", "pint"),
        "texts": count,
        "outcomes": dict(outcomes),
        "examples of what is a bug": dict(list(examples.items())[:5]),
        "seconds": round(time.perf_counter() - start),
    }
    result = json.dumps(record, indent=1, ensure_ascii=False)
    Path(__file__).with_suffix(".txt").write_text(result + "\n", encoding="utf-8")
    print(result)


if __name__ == "__main__":
    main()
