"""What is said of the paper's tables is what the committed results say."""

import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest

import s2r_spec as s2r

FOLDER = Path(__file__).parents[1] / "benchmarks" / "paper"
PAGE = (FOLDER / "README.md").read_text()
SPECS = Path(__file__).parents[1] / "specs"


def result(name: str) -> dict:
    return json.loads((FOLDER / "results" / f"{name}.json").read_text())


def line(beginning: str) -> str:
    found = [text for text in PAGE.splitlines() if text.startswith(beginning)]
    assert len(found) == 1, beginning
    return found[0]


def interval(bounds: list[float]) -> str:
    return "[" + ", ".join(f"{bound:+.4f}" for bound in bounds).replace("-", "−") + "]"


@pytest.mark.parametrize(("kernel", "name"), [("matern52", "Matérn-5/2"), ("rbf", "RBF")])
def test_repeatability(kernel, name):
    found = result("repeatability")["tables"][kernel]["all"]
    row = [cell.strip() for cell in line(f"| {name} | 120").split("|")[1:-1]]
    assert row[1:5] == ["120", str(found["median_rollouts"]), f"{found['spread']:.4f}", "0.009"]
    assert row[5] == f"{found['wrong']} (0 to {100 * found['wrong_95'][1]:.1f} %)"
    assert row[6] == str(found["further_than_epsilon"])
    assert found["labels"] == {"CERTIFIED": 120}


def test_the_bank_and_its_truth():
    truth = result("repeatability")["truth"]
    assert f"norm in Matérn-5/2(0.15 m/s) [m/s] | {truth['matern52_norm']:.2f} |" in PAGE
    assert f"around a mean of zero, would have norm {truth['norm_of_scatter_alone']:.2f}" in PAGE
    norms = result("savings")["norms"]
    assert line("| norm in").endswith(
        f"| {norms['simulator']:.2f} | {norms['machine']:.2f} | {norms['gap']:.2f} |"
    )
    for backend in ("sim", "twin_lab"):
        about = result(f"bank_{backend}")
        text = (FOLDER / "results" / f"bank_{backend}.csv").read_text()
        values = np.array(list(csv.reader(text.splitlines()))[1:], dtype=float)
        assert values[:, 1:].size == about["rollouts"]
        assert np.isfinite(values).all()
        assert about["spec_hash"] == s2r.load_spec(SPECS / "a1_velocity.stl").hash


@pytest.mark.parametrize("place", ["lab", "grass", "sand", "ramp"])
def test_environments(place):
    found = result("environments")["places"][place]
    row = [cell.strip() for cell in line(f"| {place} |").split("|")[1:-1]]
    assert row[1] == interval(found["worst_gap"])
    assert row[2] == f"{found['worst_test']:+.2f}".replace("-", "−")
    assert row[3] == f"{found['largest_mean_absolute_gap']:.4f}"
    assert row[5] == interval(found["composed"])
    assert row[7] == str(found["real_rollouts"])
    assert found["label"] == "certified under the stated assumptions"


def test_what_is_found_again_of_the_papers_orders():
    assert result("environments")["orders"] == {
        "lab has the smallest mean |Δ|": False,
        "lab is tied with the smallest": True,
        "ramp has the largest mean |Δ|": True,
        "ramp's largest is at vd = -0.2": False,
        "sand and grass are tied": True,
        "all four are certified to fail": True,
    }


def test_savings():
    for row in result("savings")["needed"]:
        shown = line(f"| {row['width']:g} |").split("|")[2:-1]
        assert [int(cell) for cell in shown] == [count for name, count in row.items() if name != "width"]


def test_every_link_leads_somewhere():
    for target in re.findall(r"\]\((?!http)([^)#]+)\)", PAGE):
        assert (FOLDER / target).exists(), target


def test_faults():
    found = result("faults")
    assert (found["lost"], found["another"]) == (0, 0)
    killed = [row for row in found["rows"] if row["fault"].startswith("kill -9, after")]
    before = [row["before"] for row in killed]
    row = [cell.strip() for cell in line("| kill -9, at").split("|")[1:-1]]
    assert row[0].split()[3] == str(len(killed)) == "20"
    assert row[2] == f"{min(before)} to {max(before)}"
    assert all(each["same"] for each in killed)
    for each in found["rows"][len(killed) :]:
        row = line(f"| {each['fault'].split(' (')[0].replace('a read-only', 'read-only')}").split("|")[1:-1]
        assert [int(row[1]), int(row[2]), int(row[3])] == [each["exit_code"], each["before"], each["lost"]]
        assert all(part.strip() in each["sentence"] for part in row[5].split("…")), row[5]


def test_budget():
    found = result("budget")
    framework, rates, memory = found["framework"], found["rollouts_per_second"], found["worker_MiB"]
    shown = {
        "| one rollout of the A1": f"{found['rollout_seconds']['median']:.3f} s",
        "| one core-hour": f"{found['rollouts_per_core_hour']} rollouts, "
        f"{found['certificates_per_core_hour']:.0f} certificates like the README's",
        "| rollouts per second": f"{rates['1']:.1f} and {rates['2']:.1f} ({found['scaling']:.2f} ×)",
        "| the framework, per rollout, processor": f"{framework['processor_ms']:.1f} ms, "
        f"of it the search {framework['of_which_search_ms']:.2f} ms",
        "| the framework, per rollout, wall": f"{framework['wall_ms']:.1f} ms",
        "| peak memory of a worker": f"{memory['usual']:.0f} MiB",
        "| peak memory of a machine's first": f"{memory['compiling']:.0f} MiB",
        "| `s2r --help`": f"{found['help_seconds']['median']:.2f} s",
    }
    for beginning, text in shown.items():
        assert line(beginning).split("|")[2].strip() == text
    load = found["load_average"]
    assert f"a load average of {load['before']:.1f} before and {load['after']:.1f} after" in PAGE
