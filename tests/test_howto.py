"""The how-to pages do what they say."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from benchmarks.certify import sizing
from s2r_spec.backend import Backend, HasEffects, registry
from s2r_spec.errors import UsageError

ROOT = Path(__file__).parents[1]
PAGES = ROOT / "docs" / "how-to"


@pytest.fixture
def cart():
    """The backend of the page, and what the page defines beside it."""
    blocks = re.findall(r"```python\n(.*?)```", (PAGES / "effects.md").read_text(), re.S)
    names = {}
    for block in blocks:
        exec(block, names)
    return names


def test_the_page_on_effects_shows_a_backend_with_effects(cart, capsys):
    robot, worn = cart["cart"], cart["worn"]
    for each in (robot, worn):
        assert isinstance(each, Backend)
        assert isinstance(each, HasEffects)
    end = [each.rollout({"vd": 0.5}, seed=0)["v"][-1] for each in (robot, worn)]
    assert end == pytest.approx([0.50, 0.37], abs=0.01)  # as the comment on the page says
    assert robot.model_hash != worn.model_hash


def test_its_effects_are_as_the_page_asks(cart):
    robot = cart["cart"]
    nominal = {e.name: {p.name: p.nominal for p in e.parameters} for e in robot.effects()}
    assert np.array_equal(robot.rollout({}, 1)["v"], robot.with_effects(nominal).rollout({}, 1)["v"])
    values = {"drag": {"rate": 1.0}, "weak_motor": {"factor": 0.9}}
    one, other = (robot.with_effects(dict(items)) for items in (values.items(), reversed(values.items())))
    assert one == other
    with pytest.raises(UsageError, match=r"the backend 'cart' has no effect 'drug'; did you mean 'drag'\?"):
        robot.with_effects({"drug": {}})


def test_its_options_are_read_and_a_class_without_any_refuses_them(cart, monkeypatch):
    made = cart["with_options"]("drag.rate=1,weak_motor.factor=0.9")
    assert made.chosen() == {"drag": {"rate": 1.0}, "weak_motor": {"factor": 0.9}}
    with pytest.raises(UsageError, match="the backend 'cart' has no effect 'drug'"):
        cart["with_options"]("drug.rate=1")
    with pytest.raises(UsageError, match="the backend 'cart' has no option 'drug'"):
        cart["with_options"]("drug")
    # The class keeps its effects in its first field, where an option would land.
    monkeypatch.setattr(registry, "_factory", lambda name: cart["Cart"])
    assert registry.load_backend("cart") == cart["Cart"]()
    with pytest.raises(UsageError, match="'worn'"):
        registry.load_backend("cart:worn")


def test_the_page_on_clusters_quotes_what_is_said():
    source = Path(__file__).parents[1] / "s2r_spec"
    names = ("workers/pools.py", "runs/runner.py", "runs/task.py")
    code = "".join((source / name).read_text() for name in names)
    said = re.sub(r"\{[^{}]*\}", "…", re.sub(r'"\n\s*f?"', "", code))
    quotes = re.findall(r"\*([^*]+)\*", (PAGES / "cluster.md").read_text().split("## What can go wrong")[1])
    assert len(quotes) == 5
    for quote in quotes:
        assert re.sub(r"\bHOST\b", "…", quote) in said, quote


def test_the_page_on_sizing_shows_what_was_measured():
    page, found = sizing.PAGE.read_text(encoding="utf-8"), json.loads(sizing.RESULTS.read_text())
    assert sorted(re.findall(r"<!-- table: (\w+) -->", page)) == sorted(sizing.TABLES)
    assert page == sizing.with_tables(page, found), "run: python -m benchmarks.certify.sizing --write"


def test_the_batches_that_were_measured_are_those_of_the_page_s_table():
    for check in json.loads(sizing.RESULTS.read_text())["checks"]:
        measured, expected = check["sizes"], sizing.batches(sum(check["sizes"]))
        assert all(size <= most for size, most in zip(measured, expected, strict=False))
        assert measured[-1] >= 8


def test_the_speed_up_is_at_most_the_workers_and_the_mean_batch():
    sizes = sizing.batches(600)
    for workers in sizing.WORKERS:
        assert 1 <= sizing.speed_up(sizes, workers) <= min(workers, sum(sizes) / len(sizes))
    assert sizing.speed_up(sizes, 1) == 1


@pytest.mark.filterwarnings("ignore::s2r_spec.errors.TraceNote")
def test_the_page_on_robot_logs_reads_episodes_in_python(monkeypatch, capsys):
    monkeypatch.chdir(ROOT)
    (block,) = re.findall(r"```python\n(.*?)```", (PAGES / "robot-logs.md").read_text(), re.S)
    exec(block, {})
    assert json.loads(capsys.readouterr().out) == pytest.approx([0.0297, 0.0298, -0.0205], abs=1e-4)


def test_the_page_on_robot_logs_has_the_figures_of_the_committed_benchmark():
    found = json.loads((ROOT / "benchmarks/results/big_bag.json").read_text())
    page = (PAGES / "robot-logs.md").read_text()
    for command in ("s2r log", "s2r monitor --when"):
        assert f"{found[command]['seconds']:.1f} s" in page
        assert f"{found[command]['peak_MB']} MB" in page


def test_the_page_on_protocols_can_be_typed(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    names = {}
    for block in re.findall(r"```python\n(.*?)```", (PAGES / "protocols.md").read_text(), re.S):
        exec(block, names)
    assert names["trace"].meta["protocol"] == "squat"
    assert len((tmp_path / "squat.csv").read_text().splitlines()) == 1002
    with pytest.raises(UsageError, match="'chrip'"):
        names["Cart"]().run("chrip", {}, 0)
    assert "chirp" in capsys.readouterr().out
