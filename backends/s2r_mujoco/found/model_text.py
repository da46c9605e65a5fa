"""The physics of a compiled model, written into the XML files that it comes from.

An attribute is written where two compiled models differ: that of the files, and that with the effects. It stands on the
element itself, so it wins over every ``<default>``. Elements are found by their names; those without one have one in a
copy of the files that only this module reads.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from s2r_mujoco.markup import Element, Markup
from s2r_mujoco.model import ModelFile

Attributes = dict[str, str | None]
_KINDS = ("body", "joint", "geom", "pair")
"""Definition: elements whose kind in a compiled model has the same name; each element of ``<actuator>`` is one, too."""
_FOLDERS = ("meshdir", "texturedir")
_TURNS = ("fullinertia", "axisangle", "xyaxes", "zaxis", "euler")
"""Definition: other attributes of ``<inertial>`` for what ``diaginertia`` and ``quat`` say."""


def changed_markup(file: ModelFile, before: Any, after: Any, folder: Path) -> Markup:
    """Return the files of a model with the physics of another one.

    Args:
        file: the model's files.
        before: they, compiled.
        after: the same model with other numbers.
        folder: in which copies of the files may be written.

    Raises:
        ValueError: the files are in another format than MuJoCo's own.
        UsageError: MuJoCo refuses a copy.
    """
    markup = Markup.read(file.path)
    for kind, element, number in _numbered(file, markup, folder):
        if kind == "body":
            _write_body(markup, element, before, after, number)
        elif kind == "actuator":
            _write_actuator(markup, element, before, after, number)
        elif attributes := _PLAIN[kind](before, after, number):
            markup.change(element, attributes)
    return markup


def place(markup: Markup, folder: Path, into: Path) -> None:
    """Write the files of a model into a folder, to be read in ``folder``; ``as_found.xml`` is the main one.

    A file that it includes is written as a copy, if it has changes or includes others. Meshes stay where they are.
    """
    main = next(iter(markup.texts))
    root = main.resolve().parent
    _keep_assets(markup, root, folder)
    includes = markup.real("include")
    copied = {main, *markup.changed, *(one.file for one in includes)}
    names = {path: "as_found.xml" if path == main else f"as_found_{path.name}" for path in copied}
    for one in includes:
        target = main.parent / one.attributes.get("file", "")
        if target in markup.texts:
            markup.change(one, {"file": names.get(target) or path_from(folder, target)})
    for path, text in markup.written().items():
        if path in copied:
            (into / names[path]).write_bytes(text.encode("utf-8", "surrogateescape"))


def path_from(folder: Path, target: Path) -> str:
    """Return the path of a file as a file in a folder names it: relative, or absolute on another drive."""
    try:
        return Path(os.path.relpath(target.resolve(), folder.resolve())).as_posix()
    except ValueError:
        return target.resolve().as_posix()


def _numbered(file: ModelFile, markup: Markup, folder: Path) -> Iterator[tuple[str, Element, int]]:
    """Yield kind, element and number in the compiled model of every element that is one element there, too."""
    named = Markup.read(file.path)
    names: list[tuple[str, Element, str]] = []
    for mine, other in zip(markup.root.every(), named.root.every(), strict=True):
        kind = _kind(mine)
        if kind:
            name = mine.attributes.get("name") or f"s2r element {len(names)}"
            named.change(other, {"name": name})
            names.append((kind, mine, name))
    place(named, folder, folder)
    model = replace(file, path=folder / "as_found.xml").compile()
    for kind, element, name in names:
        try:
            yield kind, element, int(getattr(model, kind)(name).id)
        except KeyError:  # the compiler has dropped it, or has given it another name
            continue


def _kind(element: Element) -> str:
    """Return the kind of an element in a compiled model; "" for others."""
    if not element.is_real or element.above is None:
        return ""
    if element.above.name == "actuator":
        return "actuator"
    return element.name if element.name in _KINDS else ""


def _joint(before: Any, after: Any, joint: int) -> Attributes:
    dof, found = after.jnt_dofadr[joint], Attributes()
    for name in ("damping", "frictionloss", "armature"):
        number = getattr(after, f"dof_{name}")[dof]
        if number != getattr(before, f"dof_{name}")[dof]:
            more = after.dof_dampingpoly[dof] if name == "damping" else np.zeros(1)
            found[name] = _text([number, *(more if more.any() else [])])
    return found | _rows(before, after, joint, {"actuatorfrcrange": "jnt_actfrcrange"})


def _rows(before: Any, after: Any, number: int, fields: Mapping[str, str]) -> Attributes:
    """Return attribute → text, where a row of an array differs."""
    return {
        name: _text(getattr(after, field)[number])
        for name, field in fields.items()
        if (getattr(before, field)[number] != getattr(after, field)[number]).any()
    }


_PLAIN: Mapping[str, Callable[[Any, Any, int], Attributes]] = {
    "joint": _joint,
    "geom": lambda before, after, one: _rows(before, after, one, {"friction": "geom_friction"}),
    "pair": lambda before, after, one: _rows(before, after, one, {"friction": "pair_friction"}),
}


def _write_body(markup: Markup, element: Element, before: Any, after: Any, body: int) -> None:
    """Write mass, centre and inertia of a body; they then win over those of its geoms."""
    fields = {"pos": "body_ipos", "quat": "body_iquat", "diaginertia": "body_inertia"}
    same = all((getattr(before, name)[body] == getattr(after, name)[body]).all() for name in fields.values())
    if same and before.body_mass[body] == after.body_mass[body]:
        return
    numbers = {"mass": _text([after.body_mass[body]])}
    numbers |= {name: _text(getattr(after, field)[body]) for name, field in fields.items()}
    inertial = next((one for one in element.below if one.name == "inertial"), None)
    if inertial is None:
        words = " ".join(f'{name}="{value}"' for name, value in numbers.items())
        markup.insert(element, f"<inertial {words}/>")
        return
    markup.change(inertial, {**numbers, **{name: None for name in _TURNS if name in inertial.attributes}})


def _write_actuator(markup: Markup, element: Element, before: Any, after: Any, actuator: int) -> None:
    """Write limits and gains. A motor has no gain of its own, so one with a gain becomes a ``general`` actuator."""
    ranges = {"forcerange": "actuator_forcerange", "ctrlrange": "actuator_ctrlrange"}
    found = _rows(before, after, actuator, ranges)
    gain, bias = after.actuator_gainprm[actuator], after.actuator_biasprm[actuator]
    if _rows(before, after, actuator, {"gain": "actuator_gainprm", "bias": "actuator_biasprm"}):
        if element.name == "motor":
            markup.rename(element, "general")
            found |= {"dyntype": "none", "gaintype": "fixed", "biastype": "none", "gainprm": _text(gain[:1])}
        elif element.name == "position":
            found["kp"] = _text(gain[:1])
            found |= {"kv": _text([-bias[2]])} if bias[2] else {}
            found |= {"dampratio": None} if "dampratio" in element.attributes else {}
        elif element.name == "velocity":
            found["kv"] = _text(gain[:1])
        else:  # of another kind, whose gains MuJoCo derives, this is an error of MuJoCo or of a later comparison
            found |= {"gainprm": _text(gain), "biasprm": _text(bias)}
    if found:
        markup.change(element, found)


def _keep_assets(markup: Markup, root: Path, folder: Path) -> None:
    """Let meshes, textures and attached models be found where they are."""
    assets = [one for one in markup.root.every() if "file" in one.attributes and one.name != "include"]
    for one in assets:
        if one.name == "model":
            places = (one.file.parent / one.attributes["file"], root / one.attributes["file"])
            target = next((path for path in places if path.is_file()), places[0])
            markup.change(one, {"file": path_from(folder, target)})
    if not assets:
        return
    stated: set[str] = set()
    for one in markup.real("compiler"):
        names = {"assetdir", *_FOLDERS} & one.attributes.keys()
        stated |= set(_FOLDERS) if "assetdir" in names else names
        markup.change(one, {name: path_from(folder, root / one.attributes[name]) for name in sorted(names)})
    missing = {name: path_from(folder, root) for name in _FOLDERS if name not in stated}
    if missing and (found := markup.real("compiler")):
        markup.change(found[-1], dict(missing))
    elif missing:
        words = " ".join(f'{key}="{value}"' for key, value in missing.items())
        markup.insert(markup.root, f"<compiler {words}/>")


def _text(numbers: Any) -> str:
    """Return numbers as a text with as many digits as rounding leaves."""
    return " ".join(f"{one:.12g}" for one in numbers)
