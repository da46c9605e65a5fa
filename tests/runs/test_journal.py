import json

import numpy as np
import pytest

from s2r_spec import logs
from s2r_spec.runs.journal import FILE, Journal, JournalError, Record
from s2r_spec.trace import Trace
from tests.errors import naming

HEADER = {"spec_hash": "aa", "seed": 0, "settings": {"B": 1.5, "lengthscales": (0.2,)}}


def record(query, replicate=0, rho=0.1):
    return Record(query, replicate, {"vd": 0.1}, 7, rho, None, None, 0.2)


@pytest.fixture
def journal(tmp_path):
    made = Journal.create(tmp_path / "run", HEADER, {"spec.stl": "require\n"})
    for query in range(3):
        made.append(
            record(query, rho=0.1 / 3 * query), Trace([0.0, 1.0], {"vx": [0.0, query]}, {"vx": "m/s"})
        )
    return made


def test_a_journal_comes_back_as_it_was_written(journal):
    again = Journal.resume(journal.folder, HEADER)
    assert again.records() == journal.records()
    assert again.get(2, 0).rho == 0.1 / 3 * 2
    assert again.get(9, 0) is None
    trace = logs.read(journal.folder / again.get(2, 0).trace)
    assert np.array_equal(trace["vx"], [0.0, 2.0])
    assert (journal.folder / "spec.stl").read_text() == "require\n"


def test_a_second_run_in_the_same_folder_is_refused(journal):
    with pytest.raises(JournalError, match=naming(str(journal.folder), "--resume")):
        Journal.create(journal.folder, HEADER, {})


def test_every_cut_of_the_last_line_is_repaired(journal):
    path = journal.folder / FILE
    whole = path.read_bytes()
    start = whole.rstrip(b"\n").rfind(b"\n") + 1
    for length in range(start, len(whole)):
        path.write_bytes(whole[:length])
        again = Journal.resume(journal.folder, HEADER)
        assert len(again) == 2
        assert bool(again.note) == (length > start)
        again.append(record(2), None)
        assert len(Journal.resume(journal.folder, HEADER)) == 3


def test_damage_in_the_middle_names_the_line(journal):
    path = journal.folder / FILE
    lines = path.read_bytes().splitlines(keepends=True)
    lines[2] = lines[2][:20] + b"\n"
    path.write_bytes(b"".join(lines))
    with pytest.raises(JournalError, match=naming("journal.jsonl:3")):
        Journal.resume(journal.folder, HEADER)


def lines_of(journal):
    return (journal.folder / FILE).read_bytes().splitlines(keepends=True)


def test_a_number_that_was_edited_names_its_line(journal):
    lines = lines_of(journal)
    assert b'"rho": 0.03333333333333333,' in lines[2]
    lines[2] = lines[2].replace(b'"rho": 0.03333333333333333,', b'"rho": 0.13333333333333333,')
    (journal.folder / FILE).write_bytes(b"".join(lines))
    with pytest.raises(JournalError, match=naming("journal.jsonl:3", "checksum")):
        Journal.read(journal.folder)


def test_every_changed_byte_of_a_line_is_noticed(journal):
    whole = (journal.folder / FILE).read_bytes()
    second = whole.find(b"\n") + 1
    for place in range(second, whole.find(b"\n", second)):
        (journal.folder / FILE).write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
        with pytest.raises(JournalError, match=r"journal.jsonl:2: "):
            Journal.read(journal.folder)


def test_a_line_that_was_taken_out_is_missed(journal):
    lines = lines_of(journal)
    (journal.folder / FILE).write_bytes(b"".join(lines[:2] + lines[3:]))
    with pytest.raises(JournalError, match=naming("journal.jsonl:3", "checksum")):
        Journal.resume(journal.folder, HEADER)


@pytest.mark.parametrize(
    ("change", "facts"),
    [
        ({"seed": 1}, ["seed", "0", "1"]),
        ({"spec_hash": "bb"}, ["spec_hash", '"aa"', '"bb"']),
        ({"more": 1}, ["more", "null", "1"]),
    ],
)
def test_another_run_is_refused_by_the_field_that_differs(journal, change, facts):
    with pytest.raises(JournalError, match=naming(*facts)):
        Journal.resume(journal.folder, HEADER | change)


def test_what_is_no_journal_is_refused(tmp_path):
    with pytest.raises(JournalError, match=naming(str(tmp_path))):
        Journal.read(tmp_path)
    (tmp_path / FILE).write_text(json.dumps({"schema": "other/1"}) + "\n")
    with pytest.raises(JournalError, match=naming("journal.jsonl:1", "s2r.journal/2")):
        Journal.read(tmp_path)


def test_a_value_that_is_no_number_is_never_recorded(journal):
    with pytest.raises(JournalError, match=naming("rollout 5.0", "inf")):
        journal.append(record(5, rho=float("inf")), None)
    assert len(Journal.read(journal.folder)) == 3


def test_a_full_disk_loses_nothing(journal, monkeypatch):
    def full(*args):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("s2r_spec.runs.journal.os.fsync", full)
    with pytest.raises(JournalError, match="No space left on device"):
        journal.append(record(5), None)
    monkeypatch.undo()
    assert len(Journal.resume(journal.folder, HEADER)) == 3
    assert not Journal.read(journal.folder).note


def test_a_disk_that_is_full_before_the_trace_is_written_says_how_to_go_on(journal, monkeypatch):
    def full(*args, **kwargs):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("zipfile.ZipFile", full)
    with pytest.raises(JournalError, match="No space left on device"):
        journal.append(record(5), Trace([0.0, 1.0], {"vx": [0.0, 0.0]}))
    assert len(Journal.read(journal.folder)) == 3
