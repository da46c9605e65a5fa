"""Strangers' YAML: nothing runs, nothing grows, and each fault gets one sentence with file and line."""

import os
from pathlib import Path

import pytest

from s2r_mujoco.deploy import read_deployment
from s2r_mujoco.deploy.yaml import Tagged, parse, read
from s2r_spec.errors import UsageError
from tests.errors import naming


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e-3", 0.001),
        ("-2.5E+1", -25.0),
        (".5", 0.5),
        ("7", 7),
        ("010", 10),
        ("'7'", "7"),
        ("~", None),
        ("true", True),
        ("1:30", "1:30"),
        ("2026-01-01", "2026-01-01"),
        ("!!python/tuple [1, 2]", [1, 2]),
        (
            "!!python/object/apply:builtins.slice [null, 3]",
            Tagged("python/object/apply:builtins.slice", [None, 3]),
        ),
        ("!robot {a: 1}", Tagged("!robot", {"a": 1})),
        ("a: &x [1]\nb: *x", {"a": [1], "b": [1]}),
        ("", None),
    ],
)
def test_plain_values_are_read_as_a_controller_reads_them(text, value):
    assert parse(text, "x.yaml") == value


@pytest.mark.parametrize(
    "tag",
    [
        "!!python/object/apply:os.system ['touch {0}']",
        "!!python/object/new:os.system ['touch {0}']",
        "!!python/object/apply:pathlib.Path.touch [!!python/object/apply:pathlib.Path ['{0}']]",
        "!!python/name:os.system",
        "!!python/module:antigravity",
    ],
)
def test_a_tag_makes_no_object_and_runs_nothing(tmp_path, monkeypatch, tag):
    monkeypatch.setattr(os, "system", lambda command: pytest.fail(f"ran {command}"))
    path, made = tmp_path / "deploy.yaml", tmp_path / "made"
    path.write_text(f"joint_ids_map: [0]\nstep_dt: {tag.format(made)}\nobservations: {{}}\n")
    with pytest.raises(UsageError, match=naming("deploy.yaml", "step_dt", "python")):
        read_deployment(path)
    assert not made.exists()


def bomb() -> str:
    """Return nested aliases of 9²⁰ values."""
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]" for k in range(1, 20)]
    return "\n".join(lines)


@pytest.mark.parametrize(
    ("text", "facts"),
    [
        (bomb(), ["50,000", "aliases"]),
        ("a: &a [*a]", ["line 1", "30"]),
        ("[" * 100_000, ["line 1", "30"]),
        ("? " * 100_000, ["line 1", "30"]),
        ("\n".join(" " * k + "a:" for k in range(100)), ["line 30", "30"]),
        ("[" + "1," * 60_000 + "]", ["50,000"]),
        ("a: 1\nb: 2\na: 3", ["line 3", "a", "twice"]),
        ("a: 1\n[1]: 3", ["line 2", "key"]),
        ("a: &x {b: 1}\nc:\n  <<: *x", ["line 3", "<<"]),
        ("a: 1\nb: .nan", ["line 2", ".nan"]),
        ("a: 1\nb: -.inf", ["line 2", "-.inf"]),
        ("a: 1e999", ["line 1", "1e999"]),
        ("a: " + "9" * 5000, ["line 1", "finite"]),
        ("a: 1\nb: [1", ["line 2"]),
        ("a:\n\t- 1", ["line 2"]),
        ("a: 1\n---\nb: 1", ["line 2"]),
        ("a: *none", ["line 1", "none"]),
        ("a: 1\nb: \x01", ["line 2"]),
        ("a: 1\n  b: 2", ["line 2"]),
    ],
)
def test_a_faulty_text_gets_one_sentence_with_file_and_line(text, facts):
    with pytest.raises(UsageError, match=naming("x.yaml", *facts)) as error:
        parse(text, "x.yaml")
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 300


def test_a_file_that_is_too_large_or_no_text_is_refused(tmp_path):
    path = tmp_path / "deploy.yaml"
    path.write_bytes(b"#" * 2_000_000)
    with pytest.raises(UsageError, match=naming("deploy.yaml", "1000 kB")):
        read(path)
    path.write_bytes(b"a: 1\nb: \xff")
    with pytest.raises(UsageError, match=naming("deploy.yaml", "line 2", "UTF-8")):
        read(path)
    for other in (tmp_path, tmp_path / "none.yaml"):
        with pytest.raises(UsageError, match=naming(other.name)):
            read(other)


@pytest.mark.parametrize("text", ["", "- 1", "kps: [1]\nname: x", "model: <xml/>", "a: {num_of_dofs: 3}"])
def test_an_unknown_format_names_the_known_ones_and_the_keys(tmp_path, text):
    path = tmp_path / "robot.yaml"
    path.write_text(text)
    with pytest.raises(
        UsageError, match=naming("robot.yaml", "joint_ids_map", "num_of_dofs", "num_actions")
    ) as error:
        read_deployment(path)
    assert "name" not in text or "name" in str(error.value)
    with pytest.raises(UsageError, match=naming("robot.yaml")):
        read_deployment(Path(f"{path}#walk"))
