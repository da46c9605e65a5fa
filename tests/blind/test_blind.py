"""A set is sealed, answered and opened; any change in between is found."""

import json

import pytest

from benchmarks.blind.protocol import freeze as freezing
from benchmarks.blind.protocol.freeze import BEGUN, freeze
from benchmarks.blind.protocol.seal import seal
from benchmarks.blind.protocol.unseal import unseal
from s2r_spec.errors import UsageError
from tests.errors import naming

LABELS = {
    "case-a": {"kind": "single", "effects": {"drag": {"coefficient": 2.0}}},
    "case-b": {"kind": "unknown", "effects": {"gust": {}}, "relative_of": "drag"},
    "case-c": {"kind": "null", "effects": {}},
}


ANSWERS = {name: {"verdict": "named", "which": {"answer": ["drag"]}} for name in LABELS}


@pytest.fixture
def sealed(tmp_path):
    public, labels = tmp_path / "public", tmp_path / "labels"
    labels.mkdir()
    for name, label in LABELS.items():
        (public / name).mkdir(parents=True)
        (public / name / "rollouts.csv").write_text("id,vd\nr,0.1\n")
        (labels / f"{name}.json").write_text(json.dumps(label))
    assert seal(public, labels, tmp_path / "keys") == 3
    return tmp_path


def frozen(sealed):
    return freeze(sealed / "public", sealed / "answers", lambda case: ANSWERS[case.name])


def test_a_set_is_sealed_frozen_and_opened(sealed):
    assert not list((sealed / "labels").iterdir())
    assert len(frozen(sealed)) == 64
    assert unseal(sealed / "public", sealed / "keys", sealed / "answers") == LABELS


def test_no_label_is_in_the_public_folder(sealed):
    text = b"".join(p.read_bytes() for p in (sealed / "public").rglob("*") if p.is_file())
    assert b"drag" not in text
    assert b"gust" not in text


@pytest.mark.parametrize(
    ("what", "facts"),
    [
        ("answers/case-a.json", ["case-a", "answer"]),
        ("public/case-a/rollouts.csv", ["case-a", "data"]),
        ("public/case-a.commit", ["case-a", "commitment"]),
    ],
)
def test_a_change_after_freezing_is_found(sealed, what, facts):
    frozen(sealed)
    path = sealed / what
    path.write_text(path.read_text() + " ")
    if path.suffix == ".commit":
        path.write_text("0" * 64)
    with pytest.raises(UsageError, match=naming(*facts)):
        unseal(sealed / "public", sealed / "keys", sealed / "answers")


def test_a_changed_label_does_not_match_its_commitment(sealed):
    frozen(sealed)
    path = sealed / "keys" / "case-a.json"
    path.write_text(path.read_text().replace("drag", "mass"))
    with pytest.raises(UsageError, match=naming("case-a", "label")):
        unseal(sealed / "public", sealed / "keys", sealed / "answers")


def test_answers_are_frozen_and_a_set_is_opened_only_once(sealed):
    frozen(sealed)
    with pytest.raises(UsageError, match=naming(str(sealed / "answers"), "frozen")):
        frozen(sealed)
    unseal(sealed / "public", sealed / "keys", sealed / "answers")
    with pytest.raises(UsageError, match="opened before"):
        unseal(sealed / "public", sealed / "keys", sealed / "answers")


def test_answers_of_two_versions_are_not_frozen_together(sealed, monkeypatch):
    def interrupted(case):
        if case.name == "case-b":
            raise KeyboardInterrupt
        return ANSWERS[case.name]

    with pytest.raises(KeyboardInterrupt):
        freeze(sealed / "public", sealed / "answers", interrupted)
    code = (sealed / "answers" / BEGUN).read_text().strip()
    with monkeypatch.context() as patched:
        patched.setattr(freezing, "code_hash", lambda simulator: "another")
        with pytest.raises(UsageError, match="another version"):
            frozen(sealed)
    with pytest.raises(UsageError, match="another version"):  # or of another simulator
        freeze(
            sealed / "public", sealed / "answers", interrupted, simulator="what its residuals know is other"
        )
    frozen(sealed)
    assert json.loads((sealed / "answers" / "manifest.json").read_text())["code"] == code


def test_answers_of_which_nobody_knows_the_code_are_not_frozen(sealed):
    (sealed / "answers").mkdir()
    (sealed / "answers" / "case-a.json").write_text(json.dumps(ANSWERS["case-a"]))
    with pytest.raises(UsageError, match="code"):
        frozen(sealed)


def test_labels_of_another_set_are_not_written_over(sealed, tmp_path):
    public, labels = tmp_path / "second", tmp_path / "labels"
    (public / "case-a").mkdir(parents=True)
    (public / "case-a" / "rollouts.csv").write_text("id,vd\nr,0.2\n")
    (labels / "case-a.json").write_text(json.dumps(LABELS["case-c"]))
    with pytest.raises(UsageError, match=naming("case-a", "label")):
        seal(public, labels, sealed / "keys")
    assert json.loads((sealed / "keys" / "case-a.json").read_text())["label"] == LABELS["case-a"]
    assert (labels / "case-a.json").exists()


def test_a_set_without_its_labels_is_not_sealed(tmp_path):
    (tmp_path / "public" / "x").mkdir(parents=True)
    (tmp_path / "labels").mkdir()
    with pytest.raises(UsageError, match=naming("x", "label")):
        seal(tmp_path / "public", tmp_path / "labels", tmp_path / "keys")
