"""JSON Schemas of the printed objects, derived from their records by pydantic."""

from __future__ import annotations

import re
from collections.abc import Mapping
from inspect import cleandoc
from typing import Any

from pydantic import TypeAdapter
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from typing_extensions import get_original_bases

from s2r_spec.base.errors import UsageError, one_of, suggest
from s2r_spec.base.json_values import Open, optional_fields
from s2r_spec.diagnose.before import BeforeData
from s2r_spec.diagnose.diagnosis import Diagnosis
from s2r_spec.report.records.backends import (
    BackendObject,
    BackendsObject,
    ConformanceObject,
    LoopObject,
    NewObject,
)
from s2r_spec.report.records.certificates import CertifyObject, CheckObject, GapObject
from s2r_spec.report.records.error import ErrorObject
from s2r_spec.report.records.log import LogObject
from s2r_spec.report.records.monitor import ChangeObject, MonitorObject, OnlineObject
from s2r_spec.report.records.plan import PilotObject, PlanObject
from s2r_spec.report.records.runs import ChoiceObject, OddsObject, ReplayObject
from s2r_spec.report.records.specs import ExamplesObject, FormatObject, LatexObject, LintObject

OBJECTS: Mapping[str, Any] = {
    "s2r.backend/1": BackendObject,
    "s2r.before/1": BeforeData,
    "s2r.backends/1": BackendsObject,
    "s2r.certify/1": CertifyObject,
    "s2r.check/1": CheckObject,
    "s2r.choice/1": ChoiceObject,
    "s2r.error/1": ErrorObject,
    "s2r.examples/1": ExamplesObject,
    "s2r.fmt/1": FormatObject,
    "s2r.gap/1": GapObject,
    "s2r.latex/1": LatexObject,
    "s2r.lint/1": LintObject,
    "s2r.log/1": LogObject,
    "s2r.monitor/1": MonitorObject,
    "s2r.odds/1": OddsObject,
    "s2r.online/1": ChangeObject | OnlineObject,
    "s2r.pilot/1": PilotObject,
    "s2r.plan/1": PlanObject,
    "s2r.promises/1": ConformanceObject,
    "s2r.loop/1": LoopObject,
    "s2r.new/1": NewObject,
    "s2r.replay/1": ReplayObject,
    "s2r/diagnosis/2": Diagnosis,
}
"""What an object calls itself → its record."""
INFINITE = frozenset({"s2r.monitor/1", "s2r.online/1"})
"""Objects in which a number that is not finite is a word."""


def schema(name: str) -> dict[str, Any]:
    """Return the JSON Schema of an object, such as "s2r.check/1" or "s2r.error/1".

    Raises:
        UsageError: no object has this name.
    """
    if name not in OBJECTS:
        raise UsageError(
            f"no JSON object is called {name!r}{suggest(name, OBJECTS)} the objects are {one_of(OBJECTS)}"
        )
    generator = _WithInfinities if name in INFINITE else _Described
    document = TypeAdapter(OBJECTS[name]).json_schema(schema_generator=generator)
    urn = re.sub(r"[./]", ":", name)
    return {"$schema": GenerateJsonSchema.schema_dialect, "$id": f"urn:{urn}"} | document


class _Described(GenerateJsonSchema):
    """Pydantic's schema of a record: described by its docstring, and with no further fields unless it is open."""

    def dataclass_schema(self, schema: Any) -> JsonSchemaValue:
        """Return the schema of a dataclass."""
        record, document = schema["cls"], super().dataclass_schema(schema)
        optional = optional_fields(record)
        for name, of in document["properties"].items():
            of.pop("default", None)
            if name in optional:  # absent, and so never null
                (kind,) = (each for each in of.pop("anyOf") if each != {"type": "null"})
                of |= kind
        required = [name for name in document["properties"] if name not in optional]
        return _describe(record, document | {"required": required, "additionalProperties": False})

    def typed_dict_schema(self, schema: Any) -> JsonSchemaValue:
        """Return the schema of a typed dictionary."""
        record, document = schema["cls"], super().typed_dict_schema(schema)
        return _describe(record, document | {"additionalProperties": Open in _lineage(record)})

    def field_title_should_be_set(self, schema: Any) -> bool:
        """Return that a field's name is not repeated as its title."""
        return False


class _WithInfinities(_Described):
    """The same, where a number that is not finite is a word."""

    def float_schema(self, schema: Any) -> JsonSchemaValue:
        """Return the schema of a number."""
        return {"anyOf": [super().float_schema(schema), {"enum": ["inf", "-inf", "nan"]}]}


def _describe(record: type, document: JsonSchemaValue) -> JsonSchemaValue:
    """Return a schema with the descriptions of a record's docstring, and of the docstrings of its bases."""
    for each in _lineage(record):
        section = re.search(r"^(?:Attributes|Args):\n((?: +.*\n?)+)", _plain_docstring(each), re.M)
        rows = re.findall(r"^    (\w+): (.*(?:\n     +.*)*)", section[1], re.M) if section else ()
        for name, words in rows:
            if name in document["properties"]:
                document["properties"][name]["description"] = " ".join(words.split())
    if "schema" in document["properties"]:
        document["properties"]["schema"]["description"] = "name and version of this object."
    return document | {"description": " ".join(_plain_docstring(record).split("\n\n")[0].split())}


def _lineage(record: type) -> list[type]:
    """Return the bases of a class, as it is written, and the class itself last."""
    bases = [base for base in get_original_bases(record) if isinstance(base, type)]
    return [*(each for base in bases for each in _lineage(base)), record]


def _plain_docstring(record: type) -> str:
    """Return a class's docstring without the roles of its links, in JSON's words."""
    return re.sub(r"\bNone\b", "null", re.sub(r":\w+:`~?([^`]+)`", r"\1", cleandoc(record.__doc__ or "")))
