"""Seeded damage to traces of every format: each is read, or refused in one sentence. Prints what is neither.

python -m tests.logs.fuzz 1000 --seed 7
"""

from __future__ import annotations

import argparse
import io
import json
import random
import tempfile
import traceback
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from s2r_spec import logs
from s2r_spec.errors import UsageError
from s2r_spec.logs.formats.follow import follow
from s2r_spec.logs.interpret import request
from s2r_spec.logs.mapping import ColumnRequest
from tests.logs import tables

LONGEST = 3000
"""Letters of a refusal, at most."""
NAMES = ["t", "v", "q_0", "q_1", "q[0]", "q[1]", "h.sec", "h.nanosec", "mode", "", "t [ms]", "t[us]", "v [m]"]
CELLS = [
    "t", "v", "#", "[", "]", "[m]", " [us]", "True", "no", "1e999", "nan", "NA", "inf", "-", "1718000000000000000",
    "2024-06-10T06:13:20Z", "2024-02-30", "0", "1", "0.1", "1_0", "\"", "\"\"", ",", ",,", "\n", "\r", "\0", "é",
    "9" * 400, "q[99999999]", "(ns)", "+", "\ufeff", '# s2r {"meta": {}}\n', '# s2r {"meta": {"failure": 3}}\n',
]  # fmt: skip
ORDINARY = [",", "\n", "1", "2", ",1", ",2\n", "0,1\n", "1,2\n"]
MAPS: list[dict[str, str] | None] = [
    None, {"t": "t"}, {"t": "h"}, {"t": "h.sec+h.nanosec"}, {"t": "v"}, {"v": "q[1]"}, {"q[0]": "v", "q[1]": "t"},
    {"x": "v"}, {"q": "q"},
]  # fmt: skip
WANTED: list[Any] = [None, ["v"], {"v": None}, {"q": 2}, {"q": None, "v": None}, []]
UNITS = [None, None, "ns", "s", "us", "min"]
TIMES = [
    [0, 1, 2],
    [0.0, 0.1, 0.2],
    np.array([0, 1, 2], "M8[us]"),
    ["2024-06-10T06:13:20Z"] * 3,
    [True, False, True],
]
VALUES = [[1, 2, 3], ["True", "False", "no"], [None, 1.0, 2.0], [1.5, float("inf"), 2], ["a", "b", "c"]]
BESIDE = [
    '{"units": 3}',
    "[]",
    "{",
    '{"meta": {"failure": []}}',
    '{"units": {"zz": "m"}}',
    '{"meta": {"params": 3}}',
]


def attempts(folder: Path, seed: int, count: int) -> Iterator[tuple[str, Callable[[], Any]]]:
    """Return (what it is, what reads it) of so many damaged traces."""
    rng = random.Random(seed)
    for number in range(count):
        columns, wanted, unit = rng.choice(MAPS), rng.choice(WANTED), rng.choice(UNITS)
        ending = rng.choice([".csv", ".csv", *tables.ENDINGS])
        path = folder / f"{number % 20}{ending}"
        text = _text(rng) if ending == ".csv" else ""
        if text:
            path.write_text(text, encoding="utf-8", newline="")
            asked = request(columns, wanted, unit)
            yield f"{text!r} by rows, {asked}", partial(_rows, text, asked)
        else:
            _damaged(rng, path)
        gather = rng.random() < 0.3
        about = f"{ending} {text or path.read_bytes()!r}, {columns}, {wanted}, {unit}, {gather}"
        yield about, partial(logs.load, path, columns, wanted, time_unit=unit, gather=gather)


def _rows(text: str, asked: ColumnRequest) -> None:
    list(follow(io.StringIO(text, newline="").readline, asked).samples)


def _text(rng: random.Random) -> str:
    head = ",".join(rng.choice(NAMES) for _ in range(rng.randint(1, 6))) + "\n" if rng.random() < 0.7 else ""
    cells = (rng.choice(CELLS if rng.random() < 0.4 else ORDINARY) for _ in range(rng.randint(0, 40)))
    return head + "".join(cells)


def _damaged(rng: random.Random, path: Path) -> None:
    columns: dict[str, Any] = {
        "t": rng.choice(TIMES),
        "v": rng.choice(VALUES),
        "q": np.arange(6.0).reshape(3, 2),
    }
    if rng.random() < 0.5:
        columns |= {"h.sec": [1, 2, 3], "h.nanosec": [0, 5, 10**9 * rng.randint(0, 1)], "q_0": [1, 2, 3]}
    if path.suffix == ".npz" and rng.random() < 0.3:
        np.savez(path, t=[0, 1], v=[1, 2], **{"s2r.json": np.array(rng.choice(BESIDE))})
    else:
        tables.written(path, columns)
    data = bytearray(path.read_bytes())
    for _ in range(rng.randint(0, 3)):
        place = rng.randrange(len(data))
        kind = rng.random()
        if kind < 0.6:
            data[place] ^= 1 << rng.randrange(8)
        elif kind < 0.8:
            del data[max(place, 2) :]
        else:
            data[place:place] = bytes(rng.randrange(256) for _ in range(rng.randint(1, 9)))
    path.write_bytes(data)


def faults(folder: Path, seed: int, count: int) -> list[str]:
    """Return what was neither read nor refused in a sentence."""
    found = []
    for what, attempt in attempts(folder, seed, count):
        try:
            attempt()
        except UsageError as error:
            if len(str(error)) > LONGEST:
                found.append(f"{what}\n{len(str(error))} letters")
        except Exception:
            found.append(f"{what}\n{traceback.format_exc(limit=-4)}")
    return found


def main() -> None:
    """Try as many as asked for, and print the faults."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", type=int)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        found = faults(Path(folder), given.seed, given.count)
    print(*found, json.dumps({"inputs": given.count, "seed": given.seed, "faults": len(found)}), sep="\n")
    raise SystemExit(bool(found))


if __name__ == "__main__":
    main()
