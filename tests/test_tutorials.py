"""The tutorials do what they say: their files are written, their commands run, their outputs compared."""

import json
import re
import shlex
from pathlib import Path

import pytest

from s2r_spec.certify.bound.rounding import interval_text
from tests import forked

ROOT = Path(__file__).parents[1]


def read_page(path: Path) -> str:
    """Return a page with each shell command in one line."""
    return path.read_text(encoding="utf-8").replace(" \\\n    ", " ")


PAGES = {
    path: read_page(path)
    for path in (
        ROOT / "docs" / name
        for name in (
            "tutorials/ten-seconds.md",
            "tutorials/first-spec.md",
            "tutorials/certify-a1.md",
            "tutorials/your-robot.md",
            "how-to/choose-B-R-and-kernel.md",
            "how-to/robot-logs.md",
            "how-to/coming-from-rtamt-breach-sysid.md",
        )
    )
}
FILE = re.compile(r"<!-- file: (\S+) -->\n```\w*\n(.*?)```", re.S)
OUTPUT = re.compile(r"```sh\ns2r ([^\n]*)\n```\n\n<!-- output of: s2r (.*?) -->\n```text\n(.*?)```", re.S)
KEPT = re.compile(r"<!-- from: (\S+) -->\n```text\n(.*?)```", re.S)


def numbers(text: str) -> list[float]:
    return [float(number) for number in re.findall(r"[-+]?\d+\.\d+", text)]


def agree(shown: str, printed: str) -> bool:
    """Whether two lines are equal but for a last digit, and for seconds, which are of the machine."""
    if "effort " in shown:
        shown, printed = (text.rpartition(",")[0] for text in (shown, printed))
    same_words = re.sub(r"\d+\.\d+", "#", shown) == re.sub(r"\d+\.\d+", "#", printed)
    return same_words and numbers(shown) == pytest.approx(numbers(printed), abs=2e-4)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_its_commands_print_what_it_shows(page, tmp_path):
    (tmp_path / "specs").symlink_to(ROOT / "specs")
    for name, text in FILE.findall(PAGES[page]):
        (tmp_path / name).write_text(text, encoding="utf-8")
    outputs = OUTPUT.findall(PAGES[page])
    assert len(outputs) == PAGES[page].count("<!-- output of: ")
    for typed, command, text in outputs:
        assert typed == command
        done = forked.run(shlex.split(command), tmp_path)
        printed = iter(done.stdout.splitlines() + done.stderr.splitlines())
        for shown in text.splitlines():
            if shown != "…":
                assert any(agree(shown, line) for line in printed), f"{shown}\n{done.stdout}{done.stderr}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_what_it_shows_of_a_committed_run_is_what_the_run_got(page):
    for name, text in KEPT.findall(PAGES[page]):
        kept = json.loads((ROOT / name).read_text())
        if "certificate" in kept:
            bounds, rollouts = kept["certificate"], kept["certificate"]["rollouts"]
        else:
            assert kept["command"] in PAGES[page]
            bounds, rollouts = kept["result"]["promise"], kept["result"]["gap"]["search"]["rollouts"]
            gap = kept["result"]["gap"]["worst_expected_gap"]
            assert f"worst expected Δ  in {interval_text(gap['lower'], gap['upper'])} m/s" in text
        assert f"worst expected ρ  in {interval_text(bounds['lower'], bounds['upper'])} m/s" in text
        assert f"{rollouts} rollouts" in text


def test_an_output_of_another_number_would_be_noticed():
    line = "walking violated: ρ = -0.0603 m/s"
    assert agree(line, line)
    assert not agree(line, line.replace("0.0603", "0.0608"))
    assert not agree(line, line.replace("walking", "running"))
