"""Inputs of the fuzz benchmark, of all kinds: an answer or one clean sentence, and never exit 4."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.examples import examples

ROOT = Path(__file__).parents[1]
KINDS = ("spec", "trace", "log folder", "run folder", "same verdict")
EACH = examples(10)
"""Inputs of each kind."""


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """In a process of its own: what other tests have loaded has threads, which no fork may inherit."""
    file = tmp_path_factory.mktemp("fuzz") / "fuzz.json"
    words = [
        sys.executable,
        ROOT / "benchmarks" / "fuzz.py",
        "--inputs",
        str(EACH * len(KINDS)),
        "--seed",
        "1",
        "--results",
        file,
    ]
    subprocess.run(words, cwd=ROOT, check=True, capture_output=True)
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
