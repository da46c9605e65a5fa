"""Files in TOML, read into records that pydantic checks; a mistake becomes a sentence with its key."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, ValidationError

from s2r_spec.errors import UsageError, one_of, shortened, suggest


class Table(BaseModel):
    """A table of a file in TOML: unknown keys and numbers that are not finite are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, populate_by_name=True)


def read_toml(path: Path, what: str) -> dict[str, Any]:
    """Return the content of a file in TOML; a UsageError with ``what`` it should be, if it is none."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UsageError(f"cannot read the {what} {path}: {error.strerror or error}") from None
    except RecursionError:
        raise UsageError(f"{path} is no {what}: its values are nested too deep") from None
    except ValueError as error:  # TOMLDecodeError and UnicodeDecodeError
        raise UsageError(f"{path} is not TOML: {error}") from None


_Content = TypeVar("_Content", bound=Table)


def checked(
    kind: type[_Content], table: dict[str, Any], path: Path, innermost: type[Table] | None = None
) -> _Content:
    """Return the content of a file as a record; ``innermost`` has the keys of tables below free names.

    Raises:
        UsageError: a key or a value is wrong; the message names it.
    """
    try:
        return kind.model_validate(table)
    except ValidationError as error:
        raise UsageError(f"{path}: {_sentence(error, table, innermost or kind)}") from None


def _sentence(error: ValidationError, table: dict[str, Any], kind: type[Table]) -> str:
    """Return the first mistake as a sentence with its key."""
    # A value of several possible types has a mistake for each; the deepest one is of the type that was meant.
    mistakes = [(_place(one["loc"], table), one) for one in error.errors()]
    place, first = max(mistakes, key=lambda one: (len(one[0]), not one[1]["type"].endswith("_type")))
    key = "".join(f"[{one}]" if isinstance(one, int) else f".{_quoted(one)}" for one in place).removeprefix(
        "."
    )
    if first["type"] == "extra_forbidden":
        known = sorted(_keys(kind, place[:-1]))
        return f"there is no key {key}{suggest(str(place[-1]), known)} possible keys are {one_of(known)}"
    words = first["msg"].removeprefix("Value error, ")
    for of_pydantic, ours in _WORDS.items():
        words = re.sub(of_pydantic, ours, words)
    if first["type"] == "value_error":  # a sentence of ours
        return f"{key}: {words}" if key else words
    return f"{key} {words}, but it is {shortened(repr(first['input']))}"


_WORDS = {
    "^(Input|Tuple) should": "must", "Field required": "must have more items", " after validation, not .*": "",
    "valid tuple": "list", "valid dictionary( or instance of .*)?": "table", "valid string": "text",
    "valid integer": "whole number", ", (unable to parse|got a number with) .*": "", "a valid": "a",
}  # fmt: skip
"""Definition: words of pydantic, as regular expressions → words of TOML."""


def _quoted(key: str) -> str:
    return key if re.fullmatch(r"[\w-]+", key) else repr(key)


def _place(loc: tuple[int | str, ...], table: Any) -> list[int | str]:
    """Return the keys of a place without the names of types, which pydantic adds for a value of several types."""
    found: list[int | str] = []
    for part in loc:
        has = isinstance(table, dict) or (isinstance(table, list) and isinstance(part, int))
        if has and (part in table if isinstance(table, dict) else int(part) < len(table)):
            found, table = [*found, part], table[part]
    return found


def _keys(table: type[BaseModel], place: list[int | str]) -> set[str]:
    """Return the keys of the table at a place."""
    for word in place:
        if (field := table.model_fields.get(str(word))) is not None:
            table = next(_tables(field.annotation), table)
    return {field.alias or name for name, field in table.model_fields.items()}


def _tables(annotation: Any) -> Iterator[type[BaseModel]]:
    """Yield the tables in the annotation of a key."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from _tables(part)
