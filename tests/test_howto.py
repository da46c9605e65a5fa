"""The how-to pages do what they say."""

import re
from pathlib import Path

import numpy as np
import pytest

from s2r_spec import backend
from s2r_spec.backend import Backend, HasEffects
from s2r_spec.errors import UsageError

PAGES = Path(__file__).parents[1] / "docs" / "how-to"


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
        cart["with_options"]("drug")
    # The class keeps its effects in its first field, where an option would land.
    monkeypatch.setattr(backend, "_factory", lambda name: cart["Cart"])
    assert backend.load_backend("cart") == cart["Cart"]()
    with pytest.raises(UsageError, match="'worn'"):
        backend.load_backend("cart:worn")


def test_the_page_on_clusters_quotes_what_is_said():
    source = Path(__file__).parents[1] / "s2r_spec" / "rollouts"
    code = "".join((source / name).read_text() for name in ("pools.py", "runner.py"))
    said = re.sub(r"\{[^{}]*\}", "…", re.sub(r'"\n\s*f?"', "", code))
    quotes = re.findall(r"\*([^*]+)\*", (PAGES / "cluster.md").read_text().split("## What can go wrong")[1])
    assert len(quotes) == 5
    for quote in quotes:
        assert re.sub(r"\bHOST\b", "…", quote) in said, quote
