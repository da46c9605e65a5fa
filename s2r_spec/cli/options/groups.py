"""Groups of options: sections of a command's help, and records that stand for several options of a command."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar, dataclass_transform, get_args, get_origin, get_type_hints

import typer
from typer.core import TyperCommand

Record = TypeVar("Record")

ASKED, SEARCH, LOGS, OUTPUT = "What is asked", "The search", "The logs", "Output"
"""Definition: titles of the groups, in the order of the help. What has no group is in the first."""

search_option = functools.partial(typer.Option, rich_help_panel=SEARCH)
log_option = functools.partial(typer.Option, rich_help_panel=LOGS)
output_option = functools.partial(typer.Option, rich_help_panel=OUTPUT)


@dataclass_transform(kw_only_default=True, frozen_default=True)
def options(record: type[Record]) -> type[Record]:
    """Make a class a record of options: a field's default is the default of its option, or the option itself."""
    return dataclass(frozen=True, kw_only=True)(record)


def convert_plainly(parameters: Iterable[Any]) -> None:
    """Convert texts, paths and numbers of these parameters here: typer loads pydantic for each of them."""
    for parameter in parameters:
        parameter._runtime_param = _PlainValue(parameter)


@dataclass(frozen=True)
class _PlainValue:
    """The conversion of a parameter's value; that of a choice, a pair or a wrong number is typer's."""

    parameter: Any

    def coerce(self, value: Any, param: Any, ctx: Any) -> Any:
        """Return the value of an argument or option; typer calls it."""
        several = param.multiple or param.nargs == -1
        if value is None:
            return () if several else None
        kind = self.parameter.type_descriptor.annotation
        if several and get_origin(kind) is list:
            (kind,) = get_args(kind)
        if kind in (str, Path) and isinstance(value, tuple | list if several else str):
            return [kind(one) for one in value] if several else kind(value)
        if isinstance(value, int | float):  # a default; what is typed is a text
            return value
        if kind in (int, float) and isinstance(value, str):
            limits = self.parameter.type_descriptor.parameter_info
            with suppress(ValueError):
                number = kind(value)
                if (limits.min is None or number >= limits.min) and (
                    limits.max is None or number <= limits.max
                ):
                    return number
        self.parameter._runtime_param = None  # typer makes its own
        return self.parameter.get_runtime_param().coerce(value, param=param, ctx=ctx)


class GroupedCommand(TyperCommand):
    """A command whose help lists arguments and options by group."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse a command line."""
        convert_plainly(self.get_params(ctx))
        return super().parse_args(ctx, args)

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the groups."""
        groups: dict[str, list[tuple[str, str]]] = {title: [] for title in (ASKED, SEARCH, LOGS, OUTPUT)}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record is not None:
                usual = OUTPUT if parameter.name == "help" else ASKED
                groups[getattr(parameter, "rich_help_panel", None) or usual].append(record)
        for title, records in groups.items():
            if records:
                with formatter.section(title):
                    formatter.write_dl(records)


def group_options(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command that has the fields of each record among its parameters as options in the record's place."""
    signature = inspect.signature(command, eval_str=True)
    records: dict[str, list[str]] = {}
    parameters: list[inspect.Parameter] = []
    for name, one in signature.parameters.items():
        if not is_dataclass(one.annotation):
            parameters.append(one)
            continue
        records[name] = [each.name for each in fields(one.annotation)]
        hints = get_type_hints(one.annotation, include_extras=True)
        parameters += [
            one.replace(name=each.name, default=each.default, annotation=hints[each.name])
            for each in fields(one.annotation)
        ]

    @functools.wraps(command)
    def run(**values: Any) -> None:
        made = {
            name: signature.parameters[name].annotation(**{key: values.pop(key) for key in options})
            for name, options in records.items()
        }
        command(**made, **values)

    run.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {one.name: one.annotation for one in parameters}
    return run
