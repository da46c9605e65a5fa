"""The text of a robot file with some keys changed; comments and the order of keys stay."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomlkit

from s2r_mujoco.found.model_text import path_from
from s2r_spec.effects import Values

Units = Mapping[str, Mapping[str, str]]
"""Effect → parameter → unit."""


def changed_text(text: str, changes: Mapping[str, Any], effects: Values, units: Units, comment: str) -> str:
    """Return the text of a robot file with other values.

    Args:
        text: of the file.
        changes: key → value; dots lead into tables and lists: ``action.pd``, ``observation.0.term``.
        effects: all that the table ``effects`` has.
        units: of these.
        comment: first line.
    """
    document: Any = tomlkit.parse(f"# {comment}\n{text}")
    for key, value in changes.items():
        *above, last = key.split(".")
        table = document
        for name in above:
            if isinstance(table, list):
                table = table[int(name)]
                continue
            if name not in table:
                table[name] = tomlkit.table()
            table = table[name]
        table[int(last) if isinstance(table, list) else last] = value
    document.pop("effects", None)
    if effects:
        document["effects"] = _table(effects, units)
    return tomlkit.dumps(document)


def _table(effects: Values, units: Units) -> Any:
    """Return the table of effects, with each unit as a comment."""
    table = tomlkit.table()
    for effect, values in effects.items():
        for parameter, value in values.items():
            item = tomlkit.item(float(f"{value:.12g}"))
            if units[effect][parameter]:
                item.comment(units[effect][parameter])
            table.append(tomlkit.key([effect, parameter]), item)
    return table


def moved_paths(table: Mapping[str, Any], origin: Path, folder: Path) -> dict[str, Any]:
    """Return the changes of a robot file that is moved: paths of files, as the file names them in ``folder``.

    Args:
        table: content of the robot file.
        origin: its folder.
        folder: where it goes.
    """

    def moved(name: str) -> str:
        path, mark, rest = name.rpartition(":") if ".py:" in name else (name, "", "")
        return path_from(folder, origin / path) + mark + rest

    found: dict[str, Any] = {
        key: moved(table[key]) for key in ("model", "policy", "deploy", "catalogue") if table.get(key)
    }
    for number, term in enumerate(table.get("observation", ())):
        name = term.get("term", "") if isinstance(term, Mapping) else term
        if ".py:" in name:
            found[f"observation.{number}" + (".term" if isinstance(term, Mapping) else "")] = moved(name)
    return found
