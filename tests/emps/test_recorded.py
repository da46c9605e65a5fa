"""Following a recorded reference: a file written here, and the real data set where it is at hand."""

from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat, savemat

from s2r_emps import EmpsBackend
from s2r_emps.noise import Noise
from s2r_spec.errors import UsageError
from tests.errors import naming

REAL = Path(__file__).parents[3] / "shared" / "data" / "emps"
needs_data = pytest.mark.skipif(not REAL.exists(), reason="the EMPS data set is not beside the checkout")
FRICTION = {"viscous": {"coefficient": 203.5}, "coulomb": {"force": 20.4}, "offset": {"force": -3.2}}
"""As its authors document the machine."""


@pytest.fixture
def record(tmp_path):
    """A file as in the data set, of a simulated run of 6 s."""
    t = np.arange(6001) / 1000
    asked = 0.12 - 0.1 * np.cos(2 * np.pi * t / 3)
    path = tmp_path / "record.mat"
    savemat(path, {"t": t[:, None], "qg": asked[:, None], "qm": asked[:, None]})
    return path


def test_it_follows_the_file_from_the_start_asked_for(record):
    axis = EmpsBackend(f"reference={record}")
    assert [p.name for p in axis.parameters] == ["start"]
    assert axis.parameters[0].high == pytest.approx(3.5)
    trace = axis.rollout({"start": 1.0}, 0)
    np.testing.assert_array_equal(trace["q_ref"], loadmat(record)["qg"].ravel()[1000:3501])
    assert np.abs(trace["q"] - trace["q_ref"]).max() < 2e-3
    assert axis.name == f"emps:reference={record}"
    assert axis.model_hash != EmpsBackend().model_hash


def test_a_part_of_the_record_begins_in_the_state_that_a_run_from_the_beginning_has_there(record):
    axis = EmpsBackend(f"reference={record}", noise=Noise.off()).with_effects(FRICTION)
    whole = axis.with_duration(6.0).rollout({"start": 0.0}, 0)
    part = axis.with_duration(2.0).rollout({"start": 3.2}, 0)
    assert np.abs(part["q"] - whole["q"][3200:5201]).max() < 1e-8
    assert np.abs(part["u"] - whole["u"][3200:5201]).max() < 1e-3


def test_duration_follows_the_spec_and_bounds_the_start(record):
    axis = EmpsBackend(f"reference={record}").with_duration(2.0)
    assert axis.parameters[0].high == pytest.approx(4.0)
    assert len(axis.rollout({"start": 4.0}, 0)) == 2001
    with pytest.raises(UsageError, match=naming("start = 4.1 s", "[0, 4] s")):
        axis.rollout({"start": 4.1}, 0)
    with pytest.raises(UsageError, match=naming("6 s", "7 s")):
        axis.with_duration(7.0)


@pytest.mark.parametrize(
    ("content", "facts"),
    [
        ({"qg": np.zeros(2000)}, ["'t'", "qg", "t [s]", "qg [m]"]),
        (
            {"t": np.arange(2000) / 500, "qg": np.zeros(2000)},
            ["2 ms", "1 ms"],
        ),
        ({"t": np.arange(2000) / 1000, "qg": np.zeros(1999)}, ["2000", "1999"]),
        ({"t": np.arange(4000) / 1000, "qg": np.full(4000, np.nan)}, ["finite"]),
    ],
)
def test_a_bad_file_gets_a_sentence(tmp_path, content, facts):
    path = tmp_path / "bad.mat"
    savemat(path, content)
    with pytest.raises(UsageError, match=naming("bad.mat", *facts)):
        EmpsBackend(f"reference={path}")


def test_a_file_that_is_not_there_gets_a_sentence(tmp_path):
    with pytest.raises(UsageError, match=naming("none.mat", "No such file")):
        EmpsBackend(f"reference={tmp_path / 'none.mat'}")
    (tmp_path / "text.mat").write_text("t,qg\n")
    with pytest.raises(UsageError, match=naming("text.mat", "MATLAB")):
        EmpsBackend(f"reference={tmp_path / 'text.mat'}")


@needs_data
def test_documented_friction_closes_nine_tenths_of_the_real_gap():
    file = REAL / "DATA_EMPS.mat"
    nominal = EmpsBackend(f"reference={file}").with_duration(2.0)
    real = loadmat(file)["qm"].ravel()
    gaps = []
    for axis in (nominal, nominal.with_effects(FRICTION)):
        gap = []
        for start in range(0, 24, 2):
            trace = axis.rollout({"start": start}, 0)
            measured = real[1000 * start : 1000 * start + 2001]
            gap.append(
                abs(np.abs(trace["q_ref"] - trace["q"]).max() - np.abs(trace["q_ref"] - measured).max())
            )
        gaps.append(np.mean(gap))
    assert gaps[0] > 25e-6
    assert gaps[1] < 0.1 * gaps[0]
