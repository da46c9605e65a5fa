"""What the documentation says of the sealed sets is what was measured."""

import json
import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "explanation" / "diagnosis.md"
RESULTS = ROOT / "benchmarks" / "blind" / "results"
ROWS = {
    "single effects: the answer is it": "top-1, single effects",
    "single effects: it is the likeliest effect": "most probable member, single",
    "single effects: it is in the set answered": "in the answered set, single",
    "exact pair": "exact pair first",
    "one of the pair is the likeliest effect": "one of the pair first",
    "known causes called": "known effects called unknown",
    "unknown causes with a material gap": "unknown with a material gap detected",
    "machines with nothing wrong": "null called anything else",
}


def test_the_table_of_sealed_sets():
    rows = [line.strip("| ").split(" | ") for line in PAGE.read_text().splitlines() if line.startswith("| ")]
    files = next(row for row in rows if row[0].startswith("file in"))[1:]
    scores = [json.loads((RESULTS / name.strip("`")).read_text())["scores"] for name in files]
    cases = next(row for row in rows if row[0] == "cases")[1:]
    assert [int(n) for n in cases] == [score["cases"] for score in scores]
    for words, key in ROWS.items():
        shown = next(row for row in rows if row[0].startswith(words))[1:]
        assert shown == [f"{s[key]['hits']} of {s[key]['of']}" for s in scores], words
    closed = next(row for row in rows if row[0].startswith("held-out gap above"))[1:]
    assert closed == [f"{100 * s['shrink, single']['ratio of sums']:.0f} %" for s in scores]


def test_every_set_was_frozen_before_it_was_opened():
    found = sorted(RESULTS.glob("*_scores.json"))
    assert found
    for path in found:
        kept = json.loads(path.read_text())
        manifest = json.loads((RESULTS / path.name.replace("_scores", "_manifest")).read_text())
        assert kept["frozen"] == manifest["frozen"] <= kept["opened"]
        assert sorted(manifest["answers"]) == sorted(kept["cases"])
        assert re.fullmatch(r"[0-9a-f]{64}", manifest["code"])


def test_what_is_said_of_the_real_go2():
    kept = json.loads((ROOT / "benchmarks" / "real" / "go2_diagnose.json").read_text())
    page = " ".join(PAGE.read_text().split())
    far, friction = kept["how_far"], kept["parameters"]["viscous_friction"]["coefficient"]
    assert f"*{kept['verdict']}*, nearest viscous friction of {friction['estimate']:.2f} N*m*s/rad" in page
    closed, tuned = (100 * far[key]["estimate"] for key in ("share", "tuned_share"))
    assert f"closes {closed:.0f} % of the held-out gap, {tuned:.0f} % with a little of everything" in page


def test_what_is_said_of_simpler_ways():
    kept = json.loads((RESULTS / "emps_baselines.json").read_text())
    rates = {name: rate["hits"] for name, rate in kept["rates"].items()}
    count = kept["rates"]["ρ only"]["of"]
    joint, single = rates["joint least squares"], rates["single fits"]
    said = (
        f"Simpler ways on the {count} single effects",
        f"joint least-squares fit names {joint}, the best fit of one effect {single}",
        f"the same of ρ alone {rates['ρ only']}, chance {count * kept['chance']:.0f}",
        f"`s2r diagnose` is the true one in {rates['s2r diagnose, likeliest cause']}",
    )
    page = " ".join(PAGE.read_text().split())
    for words in said:
        assert words in page, words
