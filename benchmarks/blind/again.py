"""Cases of an opened set whose gap stayed, diagnosed again with today's code: what is answered now.

    python benchmarks/blind/again.py arm FOLDER [ID ...] [--workers 2]    # FOLDER of `check.py freeze`, after `open`

The cases are those of which the frozen answer left half of a material gap or more, and of which no unknown cause was
the truth; or these. A look at what is open: no score, and nothing is tuned on it. Kept in ``results/<set>_again.json``.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))
from check import RESULTS, SETS, offered
from machine import describe

ROOT = Path(__file__).parents[2]


def stayed(case: dict[str, Any]) -> bool:
    """Return whether half of a material gap or more was left, with a cause that the catalogue has or with none."""
    far = case["how_far"]
    if case["label"]["kind"] == "unknown" or not far or not far["material"]:
        return False
    shares = [far[name]["estimate"] for name in ("share", "tuned_share") if far[name]]
    return bool(shares) and max(shares) < 0.5


def said(answer: dict[str, Any]) -> dict[str, Any]:
    """Return what is compared, of an answer as it was kept."""
    parameters = answer["which"]["parameters"] if "which" in answer else answer["parameters"]
    values = {f"{e}.{p}": v["estimate"] for e, of in (parameters or {}).items() for p, v in of.items()}
    named = answer["which"]["answer"] if "which" in answer else answer["answer"]
    return {"verdict": answer["verdict"], "answer": named, "values": values}


def main() -> None:
    """Diagnose them and keep what was said before and now."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("set", choices=tuple(SETS))
    parser.add_argument("folder", type=Path)
    parser.add_argument("ids", nargs="*")
    parser.add_argument("--workers", type=int, default=1)
    given = parser.parse_args()
    cases = json.loads((RESULTS / f"{given.set}_scores.json").read_text())["cases"]
    public, out = given.folder / given.set / "public", given.folder / f"{given.set}-again"
    found: dict[str, Any] = {}
    for name in given.ids or [name for name, case in cases.items() if stayed(case)]:
        words = [
            "s2r_spec",
            "diagnose",
            public / name / "spec.stl",
            "--sim",
            SETS[given.set][1],
            "--quiet",
            "--passive",
        ]
        words += ["--real", f"log:{public / name}", "--run", out / name, "--workers", given.workers]
        command = [sys.executable, "-m", *map(str, words)]
        done = subprocess.run(
            command, cwd=ROOT, env=offered(given.set), stdout=subprocess.DEVNULL, check=False
        )
        if done.returncode not in (0, 3):
            raise SystemExit(f"{name}: s2r diagnose ended with {done.returncode}")
        now = json.loads((out / name / "diagnosis.json").read_text())
        found[name] = {
            "effects": cases[name]["label"]["effects"],
            "frozen": said(cases[name]),
            "now": said(now) | {"reason": now["reason"], "notes": now["notes"]},
        }
        print(name, json.dumps(found[name], ensure_ascii=False), flush=True)
    result = {"cases": found, "machine": describe("scipy")}
    path = RESULTS / f"{given.set}_again.json"
    path.write_text(json.dumps(result, indent=1, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    main()
