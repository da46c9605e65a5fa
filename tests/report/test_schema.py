"""JSON Schemas derived from records, and records as JSON."""

import json
import math
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path

import jsonschema
import pytest

import s2r_spec
from s2r_spec.base.json_values import OPTIONAL, line, to_json
from s2r_spec.errors import UsageError
from s2r_spec.report.records.backends import BackendObject
from s2r_spec.report.records.schema import OBJECTS, schema


class Colour(Enum):
    RED = "red"


@dataclass(frozen=True)
class Inner:
    value: float


@dataclass(frozen=True)
class Outer:
    colour: Colour
    inner: tuple[Inner, ...]
    by_name: dict[str, tuple[int, int]]
    nothing: None = None
    absent: str | None = field(default=None, metadata=OPTIONAL)


OUTER = Outer(Colour.RED, (Inner(1.5),), {"a": (1, 2)})


def test_a_record_becomes_plain_values_in_its_order():
    assert (
        line(OUTER)
        == '{"colour": "red", "inner": [{"value": 1.5}], "by_name": {"a": [1, 2]}, "nothing": null}'
    )


@pytest.mark.parametrize(("value", "word"), [(math.inf, "inf"), (-math.inf, "-inf"), (math.nan, "nan")])
def test_a_number_that_is_not_finite_is_a_word_only_where_that_is_asked(value, word):
    assert to_json(Inner(value), infinite=True) == {"value": word}
    with pytest.raises(ValueError, match="not JSON compliant"):
        line(Inner(value))


@pytest.mark.parametrize("name", OBJECTS)
def test_every_object_has_a_schema_that_describes_each_field(name):
    derived = schema(name)
    jsonschema.Draft202012Validator.check_schema(derived)
    roots = derived.get("anyOf", [derived])
    for root in roots:
        of = derived["$defs"][root["$ref"].split("/")[-1]] if "$ref" in root else root
        assert of["properties"]["schema"]["const"] == name
        assert "schema" in of["required"]
        assert not [key for key, each in of["properties"].items() if not each.get("description")]


def test_every_printed_name_of_an_object_has_a_schema():
    """A name in the commands or reports without a record would be an object that is put together by hand."""
    package = Path(s2r_spec.__file__).parent
    texts = [path.read_text() for room in ("cli", "report") for path in (package / room).rglob("*.py")]
    assert not [text for text in texts if '"schema":' in text]


def test_an_optional_field_may_be_absent_and_is_never_null():
    found = to_json(BackendObject(name="toy", model_hash="0", parameters=(), channels=(), effects=()))
    jsonschema.validate(found, schema("s2r.backend/1"))
    assert "exclusive" not in found
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(found | {"exclusive": None}, schema("s2r.backend/1"))


def test_a_wrong_name_is_refused_with_those_that_there_are():
    with pytest.raises(UsageError, match=r"s2r\.chekc/1.*s2r\.check/1"):
        schema("s2r.chekc/1")


def test_a_schema_is_plain_json():
    assert json.loads(json.dumps(schema("s2r.check/1"))) == schema("s2r.check/1")
