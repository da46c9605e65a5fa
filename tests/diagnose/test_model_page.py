"""The figures on the page of the model are those that the benchmark printed."""

import importlib
import json
import re
from pathlib import Path

from s2r_spec.diagnose.inference.prior import BACKGROUND

ROOT = Path(__file__).parents[2]


def test_the_page_has_the_figures_of_the_benchmark():
    twins = json.loads((ROOT / "benchmarks" / "results" / "protocol_fit.json").read_text())["twins"]
    page = (ROOT / "docs" / "explanation" / "diagnosis.md").read_text()
    table = [line.split("|") for line in page.splitlines() if line.count("|") == 3]
    rows = {cells[1].strip(): cells[2].strip() for cells in table}
    rms = [one["rms"] for one in twins["errors"].values()]
    assert rows["rms error of a size, median over parameters"] == f"{twins['median rms']:.3f}"
    assert rows["parameters with an error above 0.08"] == f"{sum(one > 0.08 for one in rms)} of {len(rms)}"
    assert rows["truths in the 90 % intervals"] == f"{100 * twins['coverage']:.0f} %"
    exact = round(40 * twins["verdicts"]["exact sets"])
    assert rows["twins whose named effects are right by size"] == f"{exact} of 40"
    assert rows["effects of at least 0.25 that are not named"] == str(twins["verdicts"]["missed effects"])
    assert rows["effects below 0.125 that are named"] == str(twins["verdicts"]["wrong effects"])
    slope = {name: one["slope"] for name, one in twins["errors"].items()}
    assert f"comes out {100 * (1 - slope['ground_friction.factor']):.0f} % too small" in " ".join(
        page.split()
    )
    assert f"decay of strength {100 * (1 - slope['strength_decay.rate']):.0f} %" in " ".join(page.split())


def test_the_page_has_the_counts_of_the_plants():
    scores = json.loads((ROOT / "benchmarks" / "results" / "plants_diagnose.json").read_text())["scores"]
    page = (ROOT / "docs" / "explanation" / "diagnosis.md").read_text()
    for words, kind, key in (
        ("healthy machines without a name", "null", "nothing named"),
        ("large effects that are named alone", "single", "named alone"),
        ("large effects in their 90 % intervals", "single", "in the interval"),
    ):
        counts = [scores[f"{plant}, {kind}"] for plant in ("smooth", "stiff")]
        cells = " | ".join(f"{one[key]} of {one['machines']}" for one in counts)
        assert f"| {words} | {cells} |" in page


def test_the_pages_have_the_priors_of_the_code():
    pages = ROOT / "docs" / "explanation"
    rows = re.findall(r"\| ([\d.]+)[^|]*\| `(\w+)\.(\w+)` \|", (pages / "diagnosis-model.md").read_text())
    assert len(rows) == 7
    for value, module, name in rows:
        code = importlib.import_module(f"s2r_spec.diagnose.inference.{module}")
        assert float(value) == getattr(code, name), name
    (background,) = re.findall(
        r"standard deviation of ([\d.]+) typical", (pages / "diagnosis-answer.md").read_text()
    )
    assert float(background) == BACKGROUND
