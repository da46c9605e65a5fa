"""Ctrl-C in the middle of a rollout that started processes, ignores SIGTERM and holds the interpreter's lock."""

import os
import signal

from tests.forked import started
from tests.processes import lives, until


def test_ctrl_c_ends_the_rollouts_and_says_how_to_go_on(s2r, noted):
    words = ["check", s2r.spec(), "-b", "forks:stubborn-hang", "--workers", "1", "--run", "r"]
    with started(words, s2r.folder) as command:
        until(lambda: len(noted()) == 2)
        os.kill(command.process.pid, signal.SIGINT)
        done = command.finish()
    assert done.returncode == 130
    assert "--resume r" in done.stderr
    assert not [pid for pid, _ in noted() if lives(pid)]
