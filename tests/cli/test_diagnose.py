import json

import jsonschema
import pytest
from s2r_cart import SPEC

from s2r_spec.json_objects.schema import schema
from tests.errors import states


@pytest.fixture
def cart(s2r, tmp_path, monkeypatch, cache):
    monkeypatch.setenv("S2R_CACHE", str(cache))
    (tmp_path / "cart.stl").write_text(SPEC)
    return s2r


def test_a_cause_is_named_applied_and_used(cart):
    words = ("diagnose", "cart.stl", "--sim", "cart", "--real", "cart:real.coulomb=1.5", "--budget", 24, "-q")
    more = ("--apply", "patched.json", "--report", "gap.html")
    done = cart(*words, "--workers", 1, "--run", "run", *more, code=0)
    assert states(done.stdout.splitlines()[0], "NAMED", "coulomb")
    assert "patched:patched.json" in done.stderr
    found = json.loads((cart.folder / "run" / "diagnosis.json").read_text())
    assert found["which"]["answer"] == ["coulomb"]
    jsonschema.validate(found, schema("s2r/diagnosis/2"))
    assert found["next"] in done.stdout
    page = (cart.folder / "gap.html").read_text()
    assert "NAMED: coulomb" in page
    assert page.count("<svg") >= 4
    assert json.loads((cart.folder / "patched.json").read_text())["effects"] == found["patch"]
    gap = (
        "gap",
        "cart.stl",
        "--sim",
        "patched:patched.json",
        "--real",
        "cart:real.coulomb=1.5",
        "--budget",
        30,
    )
    cart(*gap, "--workers", 1, "-q", "--run", "gap")


def test_a_missing_patch_is_a_sentence(s2r):
    done = s2r("check", s2r.spec(), "--backend", "patched:none.json", code=2)
    assert states(done.stderr, "none.json", "No such file")
    (s2r.folder / "odd.json").write_text("{}")
    done = s2r("check", s2r.spec(), "--backend", "patched:odd.json", code=2)
    assert "odd.json" in done.stderr


def test_formats_and_places_that_cannot_be_are_said_before_anything_runs(cart):
    words = ("diagnose", "cart.stl", "--sim", "cart", "--real", "cart:real.coulomb=1.5", "-q")
    done = cart(*words, "--format", "junit", code=2)
    assert states(done.stderr, "'junit'", "json, markdown, text")
    done = cart(*words, "--report", "nowhere/gap.html", code=2)
    assert "nowhere" in done.stderr
    done = cart(*words, "--json", "--format", "markdown", code=2)
    assert states(done.stderr, "--json", "--format markdown")
    done = cart(*words, "--tuned", code=2)
    assert states(done.stderr, "--tuned", "--apply")
