"""Where the time of the tests goes: seconds by folder, and the slowest tests and files.

    python -m pytest -q -n auto --junitxml=suite.xml
    python -m tests.suite_time suite.xml [--write]

Reads the JUnit XML of one run and prints a table; a test's time has its fixtures in it. With ``--write`` the table
goes to results/suite_time.txt and the seconds of each file to results/suite_time.json, by which tests/conftest.py
starts the slowest files first.
"""

from __future__ import annotations

import argparse
import json
from collections import defaultdict
from pathlib import Path
from xml.etree import ElementTree

from benchmarks.machine import describe

RESULTS = Path(__file__).parents[1] / "benchmarks" / "results"
SHOWN = 20
"""How many of the slowest tests and files are shown."""


def times(report: Path) -> list[tuple[str, str, float]]:
    """Return (file, test, seconds) of every test of a run."""
    found = []
    for case in ElementTree.parse(report).iter("testcase"):
        place = case.get("classname", "").split(".")
        # tests.cli.test_check, or with the name of a class behind it
        module = next((k for k, word in enumerate(place) if word.startswith("test_")), len(place) - 1)
        file = "/".join(place[: module + 1]) + ".py"
        found.append((file, case.get("name", ""), float(case.get("time", 0.0))))
    return found


def summed(rows: list[tuple[str, float]]) -> list[tuple[str, float, int]]:
    """Return (name, seconds, tests), the slowest first."""
    seconds: dict[str, float] = defaultdict(float)
    count: dict[str, int] = defaultdict(int)
    for name, time in rows:
        seconds[name] += time
        count[name] += 1
    return sorted(((name, seconds[name], count[name]) for name in seconds), key=lambda row: -row[1])


def table(found: list[tuple[str, str, float]], wall: float) -> str:
    """Return seconds by folder, and the slowest files and tests."""
    folders = summed([(str(Path(file).parent), time) for file, _, time in found])
    files = summed([(file, time) for file, _, time in found])
    total = sum(time for *_, time in found)
    lines = [
        f"{len(found)} tests, {total:.0f} s in them, {wall:.0f} s from begin to end",
        "",
        "     s  part  tests  folder",
    ]
    lines += [f"{s:6.1f}  {100 * s / total:3.0f} %  {n:5}  {name}" for name, s, n in folders]
    lines += ["", f"the slowest {SHOWN} files", "     s  tests  file"]
    lines += [f"{s:6.1f}  {n:5}  {name}" for name, s, n in files[:SHOWN]]
    lines += ["", f"the slowest {SHOWN} tests", "     s  test"]
    slowest = sorted(found, key=lambda row: -row[2])[:SHOWN]
    lines += [f"{s:6.1f}  {file}::{name}" for file, name, s in slowest]
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("report", type=Path, help="the JUnit XML of a run")
    parser.add_argument("--write", action="store_true", help="also write benchmarks/results")
    words = parser.parse_args()
    found = times(words.report)
    suite = next(ElementTree.parse(words.report).iter("testsuite"))
    shown = table(found, float(suite.get("time", 0.0)))
    print(shown, end="")
    if words.write:
        machine = describe("pytest", "pytest-xdist")
        about = (
            f"{machine['processor']}, {machine['cores']} cores, Python {machine['python']}, {machine['date']}"
        )
        (RESULTS / "suite_time.txt").write_text(f"{about}\n{shown}")
        files = {file: round(s, 1) for file, s, _ in summed([(file, time) for file, _, time in found])}
        (RESULTS / "suite_time.json").write_text(
            json.dumps({"machine": machine, "files": files}, indent=1) + "\n"
        )


if __name__ == "__main__":
    main()
