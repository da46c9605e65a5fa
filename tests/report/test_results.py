"""A result in Python has the forms that the commands print: JSON, a page, one line, a table; and it comes back."""

import json
import pickle
from concurrent.futures import ThreadPoolExecutor

import jsonschema
import pytest

import s2r_spec as s2r
from s2r_spec.base.json_values import document
from s2r_spec.errors import UsageError
from s2r_spec.report.records.schema import schema
from tests.cli.conftest import SPEC
from tests.errors import naming, states
from tests.report.test_diagnosed import diagnosis

KINDS = ("check", "gap", "certify")


def one_thread():
    return ThreadPoolExecutor(1)


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    return tmp_path_factory.mktemp("results")


@pytest.fixture(scope="module")
def results(place):
    from s2r_toy import Toy

    spec = s2r.parse_spec(SPEC.replace("LIMIT", "0.1"), str(place / "spec.stl"))
    robot, worn, more = Toy(), Toy("drag"), {"budget": 8, "executor": one_thread}
    return {
        "check": s2r.check(spec, robot, place / "check", **more),
        "gap": s2r.gap(spec, robot, worn, place / "gap", **more),
        "certify": s2r.certify(spec, robot, worn, place / "certify", **more),
    }


@pytest.mark.parametrize("kind", KINDS)
def test_the_object_is_the_command_s(results, kind):
    found = results[kind].to_json()
    jsonschema.validate(found, schema(f"s2r.{kind}/1"))
    assert found["schema"] == f"s2r.{kind}/1"
    assert json.loads(json.dumps(found)) == found


@pytest.mark.parametrize("kind", KINDS)
def test_a_saved_result_comes_back_equal(results, kind, tmp_path):
    for path in (tmp_path / "kept.json", tmp_path / "folder"):
        file = results[kind].save(path)
        assert file == (path if path.suffix else path / f"{kind}.json")
        assert json.loads(file.read_text()) == results[kind].to_json()
        assert s2r.load_result(file) == results[kind]
    assert pickle.loads(pickle.dumps(results[kind])) == results[kind]


def test_the_folder_of_a_run_gives_its_result(results, place):
    for kind in KINDS:
        assert s2r.load_result(place / kind) == results[kind]


@pytest.mark.parametrize("kind", KINDS)
def test_the_page_is_that_of_the_command(results, kind, tmp_path, place):
    from tests import forked

    page = results[kind].report(tmp_path / "x.html")
    done = forked.run(["report", str(place / kind), "--output", str(tmp_path / "command.html")])
    assert done.returncode in (0, 1, 3), done.stderr
    assert page.read_bytes() == (tmp_path / "command.html").read_bytes()


@pytest.mark.parametrize("kind", KINDS)
def test_one_line_has_verdict_bounds_and_probability(results, kind):
    line = repr(results[kind])
    assert "\n" not in line
    assert len(line) < 200
    assert all(word in line for word in ("walking", "[", "m/s", "1 − 0.00"))


@pytest.mark.parametrize("kind", [*KINDS, "diagnosis"])
def test_a_table_for_a_notebook_is_small_and_safe(results, kind):
    one, spec = diagnosis(1)
    bad = "<script>alert(1)</script>"
    if kind == "diagnosis":
        from dataclasses import replace

        result = replace(one, spec=spec, notes=(bad,), assumptions=(bad,))
    else:
        result = results[kind]
    text = result._repr_html_()
    assert "<script" not in text
    assert text.startswith("<table>")
    assert len(text) < 10_000
    assert "This assumes" in text


def test_a_diagnosis_has_the_same_forms(tmp_path):
    from dataclasses import replace

    from s2r_spec.report import diagnosis_page

    plain, spec = diagnosis(1)
    one = replace(plain, spec=spec, real="twin:lab")
    assert one.to_json() == json.loads(document(plain))
    jsonschema.validate(one.to_json(), schema("s2r/diagnosis/2"))
    assert one.save(tmp_path / "kept").read_text() == document(plain) + "\n"
    assert one.report(tmp_path / "x.html").read_text() == diagnosis_page.render(plain, spec, "twin:lab")
    assert states(repr(one), "Diagnosis(confounded: ", "friction", "delay")
    assert "\n" not in repr(one)
    with pytest.raises(UsageError, match=naming("diagnosis")):
        s2r.load_result(tmp_path / "kept" / "diagnosis.json")
    with pytest.raises(UsageError, match="specification"):
        replace(plain, spec=None).report(tmp_path / "y.html")


def test_files_of_another_kind_get_one_sentence(results, tmp_path, place):
    for wrong in (
        lambda: results["check"].save("x.html"),
        lambda: results["check"].report("x.json"),
        lambda: results["check"].save(tmp_path / "none" / "x.json"),
        lambda: s2r.load_result(tmp_path),
        lambda: s2r.load_result(tmp_path / "none"),
    ):
        with pytest.raises(UsageError) as caught:
            wrong()
        assert "\n" not in str(caught.value)
    for text in ("", "[]", "{}", '{"schema": "s2r.lint/1"}', '{"schema": "s2r.gap/1", "folder": "/nowhere"}'):
        (tmp_path / "odd.json").write_text(text)
        with pytest.raises(UsageError, match=naming("odd.json")):
            s2r.load_result(tmp_path / "odd.json")


def test_an_explanation_is_one_line_or_its_four():
    spec = s2r.parse_spec("signal v {m/s}\nrequire slow: always (v <= 1 {m/s})")
    one = spec.explain(s2r.Trace([0, 1], {"v": [0, 2]}), "slow")
    assert repr(one) == "Explanation(slow violated: ρ = -1 m/s; decided at t = 1 s by `v <= 1 {m/s}`)"
    assert one._repr_html_().count("\n") == 3
    assert "v &lt;= 1" in one._repr_html_()
