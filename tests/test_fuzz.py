"""Inputs of `python -m tests.fuzz`, of all kinds: an answer or one clean sentence, and never exit 4."""

import importlib
import json

import pytest

from tests.examples import examples
from tests.forked import FORKS

KINDS = ("spec", "trace", "log folder", "run folder", "same verdict")
EACH = examples(10)
"""Inputs of each kind."""


def fuzz(file):
    """Try the inputs, and write what came of them into a file."""
    found = importlib.import_module("tests.fuzz.__main__").fuzz(range(EACH * len(KINDS)), seed=1)
    file.write_text(json.dumps(found))


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """In a process of its own: what other tests have loaded has threads, which no fork may inherit."""
    file = tmp_path_factory.mktemp("fuzz") / "fuzz.json"
    process = FORKS.Process(target=fuzz, args=(file,))
    process.start()
    process.join()
    assert process.exitcode == 0
    return json.loads(file.read_text())


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_but_an_answer_or_a_sentence(results, kind):
    assert results["inputs"][kind] == EACH
    # Processor time is the benchmark's to judge: the suite runs on machines of any speed.
    failures = [
        failure
        for failure in results["failures"]
        if failure["kind"] == kind and "processor time" not in failure["wrong"]
    ]
    assert not failures
