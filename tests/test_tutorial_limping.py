"""The tutorial on a policy that limps does what it says.

Its diagnosis takes half a minute: a slow test repeats it, and the other one takes the sizes that the page shows.
"""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from s2r_spec import load_backend, read_trace
from tests import forked
from tests.test_tutorials import FILE, OUTPUT, agree, read_page

ROOT = Path(__file__).parents[1]
PAGE = read_page(ROOT / "docs" / "tutorials" / "limping-robot.md")
COMMAND = re.compile(r"^s2r (\S[^\n]*)$|`python (twin.py [^`]*)`", re.M)
SHOWN = {command: text for _, command, text in OUTPUT.findall(PAGE)}
DIAGNOSIS = next(command for command in SHOWN if command.startswith("diagnose"))
NUMBER = re.compile(r"[-+−]?\d+(?:\.\d+)?")


@pytest.fixture
def folder(tmp_path):
    for name, text in FILE.findall(PAGE):
        (tmp_path / name).write_text(text, encoding="utf-8")
    for name in ("cart.xml", "cart.onnx"):
        shutil.copy(ROOT / "tests" / "mujoco" / name, tmp_path)
    return tmp_path


def near(shown, printed):
    """Whether two lines of an estimate are equal but for a twentieth of each number, and a unit of its last digit."""
    one, other = (NUMBER.findall(line.replace("−", "-")) for line in (shown, printed))
    return NUMBER.sub("#", shown) == NUMBER.sub("#", printed) and all(
        float(a) == pytest.approx(float(b), rel=0.05, abs=1.1 * 10.0 ** -len(a.partition(".")[2]))
        for a, b in zip(one, other, strict=True)
    )


def written_as_shown(folder):
    """Write the files with the mistake that the log shows, and the size that the page shows."""
    robot = load_backend(str(folder / "robot.toml"))
    found = robot.replayed([read_trace(path) for path in sorted((folder / "run").glob("*.npz"))[:6]])
    assert [one.name for one in found.mistakes] == ["joint_vel is 0.05 times as large"]
    size = float(re.search(r"dry_friction\.slide +(\S+) ", SHOWN[DIAGNOSIS])[1])
    robot.write_found({"dry_friction": {"slide": size}}, folder / "found", found.mistakes)


def followed(folder, diagnosed):
    """Run the page from top to bottom; ``diagnosed`` does the diagnosis instead, if there is one."""
    for command in map("".join, COMMAND.findall(PAGE)):
        words = command.split()
        if words[0].endswith(".py"):
            subprocess.run([sys.executable, *words], cwd=folder, check=True)
        elif command == DIAGNOSIS and diagnosed:
            diagnosed(folder)
        else:
            done = forked.run(words, folder)
            printed = (done.stdout + done.stderr).splitlines()
            same = near if command == DIAGNOSIS else agree
            for line in SHOWN[command].splitlines():
                assert line == "…" or any(same(line, other) for other in printed), (line, printed)


def test_its_commands_print_what_it_shows(folder):
    assert len(SHOWN) == PAGE.count("<!-- output of: ") == len(OUTPUT.findall(PAGE)) == 8
    assert all(typed == command for typed, command, _ in OUTPUT.findall(PAGE))
    assert [one for one, other in COMMAND.findall(PAGE) if not other] == [*SHOWN]
    followed(folder, written_as_shown)


@pytest.mark.slow
def test_its_diagnosis_prints_what_it_shows(folder):
    followed(folder, None)
    text = (folder / "found" / "as_found.toml").read_text()
    assert '{ term = "joint_vel", joints = [".*"], scale = [0.05, 0.05] },  # m/s, rad/s' in text


def test_an_estimate_of_another_size_would_be_noticed():
    line = "  dry_friction.slide   1.75 N (1.40 to 2.04 N)"
    assert near(line, line.replace("1.75", "1.76"))
    assert not near(line, line.replace("1.75", "2.00"))
    assert not near(line, line.replace("slide", "hinge"))
