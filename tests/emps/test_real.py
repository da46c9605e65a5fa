"""The real recordings as folders of rollouts; only where the data set is at hand."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import s2r_spec as s2r
from s2r_emps import EmpsBackend
from s2r_spec.recordings.recorded import LogBackend

ROOT = Path(__file__).parents[2]
REAL = ROOT.parent / "shared" / "data" / "emps"
needs_data = pytest.mark.skipif(not REAL.exists(), reason="the EMPS data set is not beside the checkout")


def run(*arguments):
    command = [sys.executable, "-m", "benchmarks.diagnose.emps_recordings", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, cwd=ROOT)


@needs_data
def test_the_recordings_become_folders_that_the_log_backend_and_the_spec_read(tmp_path):
    done = run("--data", REAL, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    words = [line.split() for line in done.stdout.splitlines()]
    gap = {(line[0], line[1]): float(line[4]) for line in words}
    assert gap["friction", "documented"] < 0.1 * gap["friction", "frictionless"]
    assert gap["pulses", "documented"] > 10 * gap["friction", "documented"]
    spec = s2r.load_spec(ROOT / "specs" / "emps_recorded.stl")
    axis = EmpsBackend(f"reference={REAL / 'DATA_EMPS.mat'}").with_duration(2.0)
    for name in ("friction", "pulses"):
        logged = LogBackend(str(tmp_path / name))
        assert len(logged.recordings) == 12
        assert {c.name: c.unit for c in logged.channels} == {c.name: c.unit for c in axis.channels}
        for params, trace in logged.recorded():
            assert set(spec.robustness(trace, params)) == {"tracks"}
            # The two files hold one reference, but for the last bit.
            np.testing.assert_allclose(trace["q_ref"], axis.rollout(params, 0)["q_ref"], rtol=0, atol=1e-15)
    pulsed = axis.residuals(LogBackend(str(tmp_path / "pulses")).recorded()[1][1])
    assert np.percentile(pulsed["controller"], 90) == pytest.approx(5.0, abs=0.2)


def test_missing_data_gets_a_sentence(tmp_path):
    done = run("--data", tmp_path, "--out", tmp_path / "out")
    assert done.returncode == 1
    assert "nonlinearbenchmark.org" in done.stderr
