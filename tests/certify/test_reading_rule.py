"""Runs on logs know the rule that read them; a run of another rule is not resumed, and its report names the rule."""

import pytest

import s2r_spec as s2r
from s2r_spec.certify.gap import gap
from s2r_spec.errors import UsageError
from s2r_spec.machine.manual.backend import ManualBackend
from s2r_spec.recordings import reading_rule
from s2r_spec.recordings.reading_rule import FIRST, READING
from s2r_spec.recordings.recorded import LogBackend
from s2r_spec.report.recompute import recompute, recompute_gap
from s2r_spec.runs.journal import Journal
from s2r_spec.workers.pools import in_this_process
from tests.certify.test_recorded import SPEC, check, design, record
from tests.errors import naming, states

OTHER = READING + 1


def test_a_header_has_the_rule_only_of_logs(tmp_path, toy):
    log = check(tmp_path, record(tmp_path / "log", design()))
    assert log.provenance["reading"] == READING
    assert Journal.read(tmp_path / "run").header["reading"] == READING
    simulated = check(tmp_path, "toy", run="toy", budget=8)
    assert "reading" not in simulated.provenance
    assert check(tmp_path, "toy", run="toy", budget=8, resume=True).certificate == simulated.certificate


@pytest.mark.parametrize(("rule", "shown"), [(None, FIRST), (OTHER, OTHER)])
def test_a_run_of_another_rule_is_not_resumed_and_its_report_names_it(tmp_path, monkeypatch, rule, shown):
    backend = record(tmp_path / "log", design())
    with monkeypatch.context() as changed:
        for one in (LogBackend, ManualBackend):
            changed.setattr(one, "reading", shown)
        if rule is None:
            changed.setattr(reading_rule, "header_fields", lambda backend: {})
        before = check(tmp_path, backend)
        assert ("reading" in before.provenance) == (rule is not None)
    with pytest.raises(UsageError, match=naming(f"rule {shown}", f"rule {READING}", backend, "new run")):
        check(tmp_path, backend, resume=True)
    told = recompute(tmp_path / "run").result
    assert told.certificate == before.certificate
    assert any(states(text, f"rule {shown}", f"rule {READING}") for text in told.assumptions)
    new = check(tmp_path, backend, run="new")
    assert not any(f"rule {READING}" in text for text in new.assumptions)


def test_a_gap_with_logs_is_not_resumed_either(tmp_path, toy, monkeypatch):
    backend, spec = record(tmp_path / "log", design()), s2r.parse_spec(SPEC, "spec.stl")
    with monkeypatch.context() as changed:
        changed.setattr(LogBackend, "reading", FIRST)
        changed.setattr(reading_rule, "header_fields", lambda backend: {})
        gap(spec, "toy", backend, tmp_path / "run", executor=in_this_process)
    with pytest.raises(UsageError, match=naming(f"rule {FIRST}", f"rule {READING}", backend)):
        gap(spec, "toy", backend, tmp_path / "run", resume=True)
    told = recompute_gap(tmp_path / "run").result
    assert any(states(text, f"rule {FIRST}", f"rule {READING}") for text in told.assumptions)


def test_the_hash_of_a_backend_for_logs_knows_the_rule(tmp_path, monkeypatch):
    name = record(tmp_path / "log", design())
    hashes = set()
    for rule in (FIRST, READING):
        monkeypatch.setattr(LogBackend, "reading", rule)
        monkeypatch.setattr(ManualBackend, "reading", rule)
        hashes |= {s2r.load_backend(name).model_hash, ManualBackend("night").model_hash}
    assert len(hashes) == 4
