"""Files and modules as backends, by their names, in every command."""

import json
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

import s2r_spec
from s2r_spec.backend import load_backend
from s2r_spec.certify.search.plan_request import PlanOptions, plan_request
from s2r_spec.errors import BackendError, S2RError, UsageError
from s2r_spec.runs.journal import Journal
from s2r_spec.runs.scorer import Scorer
from s2r_spec.runs.task import run_task
from s2r_spec.workers.pools import process_pool
from tests.errors import naming, states

KINDS = [
    "cart.py:glide", "cart.py:local", "cart.py:Cart", "cart.py:Cart:factor=0.9", "cart.py:cart",
    "cart.py:make:factor=0.9", "cart.py:Worn:drag.rate=1", "cart.py:Whole", "trolley:Cart", "file.glide", "patched:new",
]  # fmt: skip
"""A name of each kind."""


def here():
    return ThreadPoolExecutor(1)


def test_each_kind_of_name_gives_the_same_rollout_in_a_worker_process(s2r):
    """Both an opened name and an object, with the file's classes, go to a worker."""
    (s2r.folder / "trolley.py").write_text((s2r.folder / "cart.py").read_text())
    (s2r.folder / "new").write_text(
        json.dumps({"schema": "s2r/patched/1", "base": "cart.py:Worn", "effects": {"drag": {"rate": 2.0}}})
    )
    spec, ends = s2r_spec.load_spec("spec.stl"), {}
    with process_pool(1)() as pool:
        for name in KINDS:
            for backend in (name, load_backend(name)):
                scorer = Scorer.for_spec(spec, "walking", backend)
                task = scorer.task(0, 0, {"vd": 0.2}, 7)
                if backend == name or scorer.passed.portable:
                    there, own = pool.submit(run_task, task).result()[0], run_task(task)[0]
                    assert np.array_equal(there["vx"], own["vx"]), name
                    ends[name] = float(own["vx"][-1])
    assert ends["cart.py:Cart"] == ends["cart.py:glide"] == ends["cart.py:local"] == ends["trolley:Cart"]
    assert ends["cart.py:Cart:factor=0.9"] == ends["cart.py:cart"] == ends["cart.py:make:factor=0.9"]
    assert ends["cart.py:Cart"] > ends["patched:new"] > ends["cart.py:cart"]


@pytest.mark.parametrize("name", ["cart.py:Cart:factor=0.9", "cart.py:Worn:drag.rate=1.0", "cart.py:glide"])
def test_a_name_builds_the_same_backend_again(s2r, name):
    first = load_backend(name)
    assert first.name == name
    assert load_backend(first.name).model_hash == first.model_hash != load_backend("cart.py:Worn").model_hash


def test_a_check_in_worker_processes_is_replayed_and_resumed(s2r, monkeypatch):
    """Until the file is gone or has changed. No process could get this function as an object."""
    night, options = s2r.folder / "night", {"budget": 8, "resume": True}
    first = s2r_spec.check("spec.stl", "cart.py:local", night, budget=8, executor=process_pool(1))
    assert s2r_spec.replay(f"{night}#0.0").same
    again = s2r_spec.check("spec.stl", "cart.py:local", night, executor=here, **options)
    assert again.certificate == first.certificate
    (s2r.folder / "elsewhere").mkdir()
    monkeypatch.chdir("elsewhere")
    with pytest.raises(UsageError, match=naming("cart.py", os.getcwd())):
        s2r_spec.replay(f"{night}#0.0")
    monkeypatch.chdir("..")
    (s2r.folder / "constants.py").write_text("GAIN = 11.0\n")
    assert states(s2r_spec.replay(f"{night}#0.0").difference, "the model has changed")
    with pytest.raises(UsageError, match=naming("model_hash")):
        s2r_spec.check("spec.stl", "cart.py:local", night, executor=here, **options)


def test_a_file_against_itself_with_options(s2r):
    names = "cart.py:Cart", "cart.py:Cart:factor=0.9"
    s2r_spec.certify("spec.stl", *names, s2r.folder / "night", budget=8, executor=here)
    sim, real = (Journal.read(s2r.folder / "night" / "gap" / of).header[of] for of in ("sim", "real"))
    assert (sim["backend"], real["backend"]) == names
    assert sim["model_hash"] != real["model_hash"]
    planned = plan_request(s2r_spec.load_spec("spec.stl"), PlanOptions(backend=names[0]))
    assert planned.seconds * planned.at_once == 1e-3


def test_a_diagnosis_names_the_effect_of_a_file(s2r, cache):
    spec = s2r_spec.load_spec("spec.stl")
    found = s2r_spec.diagnose(spec, "cart.py:Worn", "cart.py:Worn:motor.factor=0.8", cache=cache, where=False)
    assert found.which.asserted == ("motor",)


def test_backends_describes_and_checks_a_file(s2r):
    described = s2r("backends", "cart.py:Worn", code=0).stdout
    assert states(described, "cart.py:Worn", "drag", "--spec SPEC")
    assert states(
        s2r("backends", "cart.py:Worn", "--spec", "spec.stl", code=0).stdout, "vd", "[-0.2, 0.3] m/s"
    )
    assert s2r.json("backends", "cart.py:Whole", code=0)["model_hash"] == "whole-1"
    assert "BROKEN" not in s2r("backends", "cart.py:Worn", "--check", "--spec", "spec.stl", code=0).stdout
    assert states(s2r("backends", "cart.py:Cart", "--check", code=2).stderr, "--spec SPEC")


@pytest.mark.parametrize(
    ("name", "facts"),
    [
        ("cart.py", ["cart.py:NAME", "Cart", "Worn"]),
        ("cart.py:Crat", ["'Crat'", "did you mean 'Cart'"]),
        ("kart.py:Cart", ["kart.py", "did you mean 'cart.py'"]),
        ("cart.py:TIMES", ["cart.py:TIMES", "ndarray"]),
        ("cart.py:Partial", ["'cart.py:Partial'", "lacks duration"]),
        ("cart.py:Machine", ["cart.py:Machine", "machine", "channels"]),
        ("cart.py:Seedless", ["cart.py:Seedless", "(params)", "rollout(params, seed)"]),
        ("cart.py:Worn:drag.rat=1", ["'drag'", "'rat'", "did you mean 'rate'"]),
        ("cart.py:Worn:drag.rate=9", ["drag", "[0, 5] 1/s"]),
        ("cart.py:Worn:slow", ["cart.py:Worn", "'slow'"]),
        ("cart.py:glide:slow", ["'cart.py:glide'", "'slow'"]),
        ("cart.py:cart:slow", ["'cart.py:cart'", "'slow'"]),
        ("cart.py:Cart:factor=much", ["cart.py:Cart:factor=much", "line 24", "ValueError", "'much'"]),
        ("crat:Cart", ["'crat'", "toy", "PATH.py:NAME"]),
        ("other.glide", ["other.glide"]),
        ("spec.stl", ["spec.stl", "glide", "py"]),
    ],
)
def test_a_name_that_makes_no_backend_gets_one_sentence(s2r, name, facts):
    with pytest.raises((UsageError, BackendError), match=naming(*facts)) as caught:
        load_backend(name)
    assert "\n" not in str(caught.value)


def test_an_installed_name_comes_before_a_module_of_the_same_name(s2r):
    (s2r.folder / "toy.py").write_text("def drag(params, seed): pass\n")
    assert type(load_backend("toy:drag")).__name__ == "Toy"
    assert load_backend("toy.py:drag").name == "toy.py:drag"


def test_a_file_may_change_between_two_runs_of_a_process(s2r):
    options = {"budget": 8, "executor": here}
    first = s2r_spec.check("spec.stl", "cart.py:Cart", s2r.folder / "one", **options)
    (s2r.folder / "constants.py").write_text("GAIN = 5.25\n")
    again = s2r_spec.check("spec.stl", "cart.py:Cart", s2r.folder / "two", **options)
    assert again.certificate != first.certificate


def test_a_function_with_effects_gets_the_value_of_each(s2r):
    robot = load_backend("cart.py:Worn")
    given = []
    recording = replace(robot, function=lambda params, seed, values: given.append(values))
    recording.rollout({}, 0)
    recording.with_effects({"drag": {"rate": 2.0}}).rollout({}, 0)
    assert given == [
        {"drag": {"rate": 0.0}, "motor": {"factor": 1.0}},
        {"drag": {"rate": 2.0}, "motor": {"factor": 1.0}},
    ]
    worn = robot.with_effects({"drag": {"rate": 2.0}}).with_effects({"motor": {"factor": 0.9}})
    assert worn.chosen() == {"drag": {"rate": 2.0}, "motor": {"factor": 0.9}}
    assert load_backend(worn.name).model_hash == worn.model_hash
    assert worn.with_effects({}) == worn


def test_an_object_whose_file_differs_on_the_worker_does_not_run(s2r):
    from s2r_spec.backend import files

    data = files.pack(load_backend("cart.py:Cart"))
    files._DIGESTS.clear()  # as in another process
    files.unpack(data)
    files._DIGESTS.clear()
    (s2r.folder / "constants.py").write_text("GAIN = 11.0\n")
    with pytest.raises(S2RError, match=naming("cart.py")):
        files.unpack(data)
