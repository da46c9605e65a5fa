"""`check` on recordings: a fixed design, every recording once, and what it leaves open."""

import numpy as np
import pytest

import s2r_spec as s2r
from s2r_spec.errors import UsageError
from s2r_spec.report.recompute import recompute
from s2r_spec.runs.journal import Journal
from s2r_spec.runs.replay import replay
from s2r_spec.runs.task import open_backend
from s2r_spec.workers.pools import in_this_process
from tests.errors import naming, states

SPEC = """\
signal vx {m/s}
param  vd {m/s} in [-0.2, 0.3]
require walking: always[0.5 s, 1.5 s] (abs(vx - vd) <= 0.1 {m/s})
certify walking: delta = 1e-3, epsilon = 0.05, B = 0.5, R = 0.02, kernel = rbf(0.2 {m/s}), fall = -0.5
"""
TIMES = np.arange(16) / 10


def record(folder, tests, *, header="id,vd [m/s]", unit="m/s", scale=1.0, **changes):
    """Write (vd, more columns…) tests as a robot might have logged them: vx = vd and a little noise."""
    folder.mkdir()
    rng, rows = np.random.default_rng(0), [header]
    for number, values in enumerate(tests):
        columns = values if isinstance(values, tuple) else (values,)
        rows.append(",".join([f"r{number}", *(repr(scale * columns[0]), *map(repr, columns[1:]))]))
        channel = columns[0] + 0.01 * rng.normal() + 0 * TIMES
        settings = {"times": TIMES, "meta": {}} | changes.get(f"r{number}", {})
        channel = channel[: len(settings["times"])]
        units = {"vx": unit} if unit else {}
        s2r.write_trace(
            s2r.Trace(settings["times"], {"vx": channel}, units, settings["meta"]), folder / f"r{number}.npz"
        )
    (folder / "rollouts.csv").write_text("\n".join(rows) + "\n")
    open_backend.cache_clear()  # a worker opens a backend once; here folders come and go
    return f"log:{folder}"


def design(seed=0, tests=40):
    """Return values of vd that lie on no grid, some of them several times."""
    rng = np.random.default_rng(seed)
    return [vd for vd in rng.uniform(-0.2, 0.3, tests).tolist() for _ in range(rng.integers(1, 5))]


def check(tmp_path, backend, text=SPEC, run="run", **words):
    spec = s2r.parse_spec(text, "spec.stl")
    return s2r.check(spec, backend, tmp_path / run, executor=in_this_process, **words)


def test_every_recording_counts_once_and_the_interval_is_valid_but_wide(tmp_path):
    tests = design()
    result = check(tmp_path, record(tmp_path / "log", tests))
    assert result.verdict.value == "holds"
    assert result.certificate.rollouts == len(tests)
    assert result.certificate.points == 40
    assert result.lower <= 0.1 - 0.01 * np.sqrt(2 / np.pi) <= result.upper
    journal = Journal.read(tmp_path / "run")
    assert sorted(record.params["vd"] for record in journal.records()) == sorted(tests)
    assert any("fixed beforehand" in text for text in result.assumptions)
    assert any("as it was when it was recorded" in text for text in result.assumptions)


def test_too_few_recordings_say_what_they_cannot_certify(tmp_path):
    result = check(tmp_path, record(tmp_path / "log", [-0.1, 0.0, 0.05]))
    assert result.certificate.label is s2r.Label.BUDGET
    assert result.verdict.value == "unknown"
    assert states(result.reason, "3 recorded rollouts", "ε = 0.05", "vd = 0.3")
    assert any(states(text, "R", "twice") for text in result.assumptions)


def test_a_recording_is_replayed_from_the_journal_bit_for_bit_and_a_run_resumed(tmp_path):
    backend = record(tmp_path / "log", design())
    result = check(tmp_path, backend)
    for key in ("0.0", "3.0", f"{result.lowest.query}.{result.lowest.replicate}"):
        assert replay(f"{tmp_path / 'run'}#{key}").same
    again = check(tmp_path, backend, resume=True)
    assert again.certificate == result.certificate
    # from the journal alone, as `s2r report` does it
    told = recompute(tmp_path / "run").result
    assert (told.certificate, told.reason) == (result.certificate, result.reason)
    assert told.assumptions == result.assumptions


def test_tests_outside_the_space_and_with_another_fixed_value_are_named_and_not_used(tmp_path):
    tests = [(vd, load) for vd in (-0.3, -0.1, 0.1, 0.3) for load in (0.0, 2.0)]
    text = SPEC.replace("require", "param  load {kg} = 2\nrequire")
    result = check(tmp_path, record(tmp_path / "log", tests, header="id,vd [m/s],load [kg]"), text)
    assert result.certificate.rollouts == 3
    assert any("5 of 8 recordings have tests outside the spec's test space" in t for t in result.assumptions)


def test_units_are_converted_and_the_ends_of_the_range_survive_it(tmp_path):
    metres = check(tmp_path, record(tmp_path / "a", [-0.2, -0.07, 0.1, 0.3]), run="metres")
    backend = record(tmp_path / "b", [-0.2, -0.07, 0.1, 0.3], header="id,vd [cm/s]", scale=100.0)
    centimetres = check(tmp_path, backend, run="centimetres")
    assert centimetres.certificate.rollouts == 4
    assert centimetres.lower == pytest.approx(metres.lower, abs=1e-9)


def test_a_channel_without_a_unit_is_read_in_the_specs_and_that_is_said(tmp_path):
    result = check(tmp_path, record(tmp_path / "log", [0.0, 0.1], header="id,vd", unit=""))
    assert (
        f"the channel 'vx' of {tmp_path}/log/r0.npz has no unit; its numbers are read as m/s"
        in result.assumptions
    )


def test_a_fall_has_the_declared_value(tmp_path):
    backend = record(tmp_path / "log", [0.0, 0.0, 0.1], r1={"times": TIMES[:5], "meta": {"failure": "fall"}})
    result = check(tmp_path, backend)
    assert result.failures == {"fall": 1}
    assert result.lowest.rho == -0.5


@pytest.mark.parametrize(
    ("tests", "changes", "words", "facts"),
    [
        ([0.0, 0.1], {"r1": {"times": TIMES[:9]}}, {}, ["r1.npz", "'walking'", "1.5 s", "0.8 s"]),
        ([0.5, 0.6], {}, {}, ["2 recordings", "spec.stl", "vd in [-0.2, 0.3]"]),
        (
            [(0.0, 1.0), (0.1, 2.0)],
            {"header": "id,vd,load [kg]"},
            {},
            ["'load'", "1", "2 kg", "spec.stl"],
        ),
        ([0.0, 0.1], {"header": "id,speed"}, {}, ["'vd'", "log:"]),
        ([0.0, 0.1], {}, {"budget": 20}, ["budget", "log:"]),
        ([0.0, 0.1], {}, {"stop": "decided"}, ["stop", "'decided'", "log:"]),
    ],
)  # fmt: skip
def test_what_cannot_be_used_gets_a_sentence(tmp_path, tests, changes, words, facts):
    with pytest.raises(UsageError, match=naming(*facts)):
        check(tmp_path, record(tmp_path / "log", tests, **changes), **words)
