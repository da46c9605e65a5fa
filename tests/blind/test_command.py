"""``python -m benchmarks.blind.protocol``: a set of two machines from its sealing to its labels."""

import csv
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from s2r_cart import SPEC, real

from s2r_spec import logs

ROOT = Path(__file__).parents[2]
WITHHELD = {"a": {"viscous": 2.5}, "b": {"tilt": -2.0}}


class Command:
    """Runs the module in a folder of its own."""

    def __init__(self, folder):
        self.folder = folder

    def __call__(self, *words, code):
        command = [sys.executable, "-m", "benchmarks.blind.protocol", *map(str, words)]
        path = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
        done = subprocess.run(
            command,
            cwd=self.folder,
            env=os.environ | {"PYTHONPATH": path},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == code, done.stderr + done.stdout
        return done


@pytest.fixture
def made(tmp_path, toy, monkeypatch, cache):
    monkeypatch.setenv("S2R_CACHE", str(cache))
    (tmp_path / "labels").mkdir()
    for number, (name, effects) in enumerate(WITHHELD.items()):
        case, rng = tmp_path / "public" / name, np.random.default_rng(number)
        case.mkdir(parents=True)
        (case / "spec.stl").write_text(SPEC)
        with (case / "rollouts.csv").open("w", newline="") as stream:
            table = csv.writer(stream)
            table.writerow(("id", "vd [m/s]", "acc [m/s^2]"))
            for k in range(20):
                test = {"vd": rng.uniform(0.2, 1), "acc": rng.uniform(1, 4)}
                logs.write(real(test, 1000 * (number + 3) + k, effects), case / f"{k:02d}.npz")
                table.writerow((f"{k:02d}", *test.values()))
        label = {
            "id": name,
            "kind": "single",
            "effects": {
                effect: {"coefficient" if effect == "viscous" else "force": value}
                for effect, value in effects.items()
            },
        }
        (tmp_path / "labels" / f"{name}.json").write_text(json.dumps(label))
    return Command(tmp_path)


@pytest.mark.slow  # the same steps without the command line are in tests/blind/test_blind.py
def test_a_set_from_its_sealing_to_its_labels(made):
    seal = ("seal", "public", "--labels", "labels", "--keys", "keys")
    freeze = ("freeze", "public", "--answers", "answers", "--sim", "cart", "--workers", 1, "-q")
    open_ = ("open", "public", "--keys", "keys", "--answers", "answers")
    assert "is not sealed" in made(*freeze, code=2).stderr
    assert made(*seal, code=0).stdout == "2 labels sealed; salts and labels are in keys\n"
    assert not list((made.folder / "labels").glob("*.json"))
    assert "manifest.json" in made(*open_, code=2).stderr  # nothing is opened before answers are frozen
    done = made(*freeze, code=0)
    assert done.stdout.startswith("frozen: answers, manifest ")
    assert "these answers are frozen" in made(*freeze, code=2).stderr
    path = made.folder / "answers" / "a.json"
    answer = path.read_text()
    path.write_text(answer.replace('"viscous"', '"coulomb"'))
    assert "a.json is not the answer that was frozen" in made(*open_, code=2).stderr
    assert not list((made.folder / "answers").glob("opened*"))  # and nothing has left the keys
    path.write_text(answer)
    assert made(*open_, code=0).stdout == "2 labels opened into answers\n"
    answers = made.folder / "answers"
    assert json.loads((answers / "opened.json").read_text())["labels"]["a"]["effects"] == {
        "viscous": {"coefficient": 2.5}
    }
    assert [json.loads((answers / f"{name}.json").read_text())["which"]["answer"] for name in WITHHELD] == [
        [name] for each in WITHHELD.values() for name in each
    ]


def test_it_is_no_command_of_the_users(made):
    listed = subprocess.run(
        [sys.executable, "-m", "s2r_spec", "--help"], capture_output=True, text=True, check=True
    ).stdout
    assert "diagnose" in listed
    assert "blind" not in listed
    made("--help", code=0)
    assert (
        "is not sealed"
        in made("freeze", "public", "--answers", "answers", "--sim", "cart", "-q", code=2).stderr
    )
