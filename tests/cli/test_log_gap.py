"""`gap` and `certify` on `log:FOLDER`, and the page that shows them."""

import re
import shutil
from pathlib import Path

import pytest

from tests.certify.logs import record_from
from tests.cli.conftest import FINE
from tests.errors import states

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/how-to/recorded-rollouts.md").read_text(encoding="utf-8")


def test_the_commands_take_a_log_as_the_real_machine(s2r):
    log = record_from("toy:drag", [vd / 40 for vd in range(-8, 13) for _ in range(8)], s2r.folder / "night")
    words = (s2r.spec(0.15, FINE), "--sim", "toy", "--real", "log:night", "-q")
    assert log.endswith("/night")
    done = s2r("certify", *words, "-v", code=0)
    assert states(done.stdout, "in [", "log:night", "1 − 0.002", "168 rollouts", "21 tests", "ε")
    done = s2r("gap", "spec.stl", "--sim", "log:night", "--real", "toy", code=2)
    assert "log:night" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.slow
def test_the_page_shows_what_the_commands_print(s2r, monkeypatch):
    (s2r.folder / "specs").mkdir()
    shutil.copy(ROOT / "specs/turtlebot.stl", s2r.folder / "specs")
    monkeypatch.chdir(s2r.folder)
    exec(re.search(r"```python\n(.*?)```", PAGE, re.S)[1], {})
    command = re.search(r"```sh\ns2r (gap .*?)\n```", PAGE)[1]
    printed = s2r(*command.split(), "-q", "-v", code=3).stdout
    for line in re.search(r"```text\n(.*?)```", PAGE, re.S)[1].splitlines():
        if re.match(r"  (worst expected Δ|worst gap at|largest mean|label) | {3}- the ", line):
            assert line in printed
