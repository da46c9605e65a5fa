"""A MuJoCo model from its files: what the files lack, the files that decide it, and fields set before compiling.

A *field* is an attribute of an element of the model's description, ``kind/name/attribute`` or, for one component,
``kind/name/attribute/index``: ``body/trunk/mass``, ``geom/floor/friction/0``, ``option/timestep``. A name may end or
begin with ``*`` and then stands for all elements that fit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cached_property
from pathlib import Path, PurePath, PureWindowsPath
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np

from s2r_mujoco.fixed_base import hold_bases
from s2r_mujoco.model_files import model_files
from s2r_spec.errors import UsageError, one_of, suggest

_KINDS = {
    "body": "bodies",
    "geom": "geoms",
    "joint": "joints",
    "actuator": "actuators",
    "site": "sites",
    "sensor": "sensors",
    "tendon": "tendons",
    "equality": "equalities",
    "pair": "pairs",
}
"""Definition: kind of an element in a field → the list of these elements in an ``MjSpec``."""

_ALL = 2**31 - 1
"""Definition: bits of all groups of collisions."""
ROUNDING = 1e-9
"""Tolerance: relative difference of numbers that MuJoCo's compiler computes in another order."""


@dataclass(frozen=True)
class FieldChange:
    """A change of a field of the model.

    Attributes:
        field: the field, as the module's docstring describes it.
        how: ``set``, ``add`` or ``scale``.
    """

    field: str
    how: str = "set"


@dataclass(frozen=True)
class ModelFile:
    """A model's file, with the settings of a robot file that apply before compiling.

    Attributes:
        path: the XML file (MJCF, or URDF with actuators of MuJoCo).
        floor: whether to add a plane at z = 0.
        timestep: physics step [s]; None for the file's own.
        motors: whether to add a torque motor to each hinge and slide, in the order of the model.
        held: whether the base is fixed, away from everything that is fixed itself.
        fields: fields that the robot file sets, with their values.
    """

    path: Path
    floor: bool = False
    timestep: float | None = None
    motors: bool = False
    held: bool = False
    fields: tuple[tuple[FieldChange, float], ...] = ()

    @cached_property
    def files(self) -> tuple[Path, ...]:
        """The file itself, and every file that it includes or loads; a missing one is left out."""
        return model_files(self.path)

    def compile(
        self,
        changes: Mapping[FieldChange, float] | None = None,
        pictures: bool = False,
        edit: Callable[[Any], None] | None = None,
    ) -> Any:
        """Return a compiled model with some fields changed; with what only ``pictures`` need, or without.

        ``edit`` changes the description after that.

        Raises:
            UsageError: a file is missing or broken, a field does not exist, or MuJoCo refuses a value.
        """
        spec = self.spec()
        # Without textures and visual meshes, a compilation takes 2 ms instead of 50. Rangefinders see visual meshes.
        ranging = any(int(one.type) == int(mujoco.mjtSensor.mjSENS_RANGEFINDER) for one in spec.sensors)
        spec.compiler.discardvisual = not (pictures or ranging)
        for change, value in (changes or {}).items():
            self.change(spec, change, value)
        if edit is not None:
            edit(spec)
        try:
            return spec.compile()
        except ValueError as error:
            values = ", ".join(
                f"{change.field} ({change.how} {value:g})" for change, value in (changes or {}).items()
            )
            raise UsageError(
                f"{self.path}: MuJoCo refuses the model{' with ' * bool(values)}{values}: {_words(error)}"
            ) from None

    def spec(self) -> Any:
        """Return the parsed description, without visual meshes whose files are missing, and with a floor if asked."""
        if not self.path.is_file():
            raise UsageError(f"the model {self.path} is not a file; name a MuJoCo XML file in `model`")
        try:
            spec = mujoco.MjSpec.from_file(str(self.path))
        except ValueError as error:
            words = _words(error)
            broken = _broken(self.files) if "parse error" in words else ""
            raise UsageError(broken or f"{self.path}: MuJoCo cannot read the model: {words}") from None
        _drop_missing_visuals(spec, self.path, self.files)
        if self.timestep is not None:
            spec.option.timestep = self.timestep
        if self.floor:
            spec.worldbody.add_geom(
                name="" if spec.geom("floor") else "floor",
                type=mujoco.mjtGeom.mjGEOM_PLANE,
                size=[0.0, 0.0, 0.05],
                contype=_ALL,  # a robot's geoms may leave out the first group
                conaffinity=_ALL,
            )
        if self.motors:
            self._add_motors(spec)
        if self.held:
            hold_bases(spec)
        for change, value in self.fields:
            self.change(spec, change, value)
        # A rollout ends at a warning; MuJoCo would begin it again at the start pose.
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        return spec

    def _add_motors(self, spec: Any) -> None:
        if spec.actuators:
            raise UsageError(f"{self.path} has {len(spec.actuators)} actuators; leave out motors = true")
        scalar = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
        for joint in [one for one in spec.joints if one.type in scalar]:
            if not joint.name:
                raise UsageError(f"{self.path}: a joint has no name, and motors = true needs one")
            spec.add_actuator(name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)

    def value(self, change: FieldChange) -> float:
        """Return the value of a field in the file: that of the first element that fits.

        Raises:
            UsageError: there is no such field.
        """
        holder, attribute, index = next(iter(self._holders(self.spec(), change.field)))
        value = getattr(holder, attribute)
        return float(value if index is None else value[index])

    def change(self, spec: Any, change: FieldChange, value: float) -> None:
        """Change a field of a parsed description."""
        for holder, attribute, index in self._holders(spec, change.field):
            before = getattr(holder, attribute)
            old = before if index is None else before[index]
            new = {"set": value, "add": old + value, "scale": old * value}[change.how]
            if index is None:
                setattr(holder, attribute, type(before)(new))
            else:
                before[index] = new

    def _holders(self, spec: Any, field: str) -> list[tuple[Any, str, int | None]]:
        """Return (element, attribute, index) of every number that a field names."""
        kind, *rest = field.split("/")
        if kind == "option":
            elements, rest = [spec.option], ["", *rest]
        elif kind in _KINDS and len(rest) >= 2:
            every = list(getattr(spec, _KINDS[kind]))
            elements = [one for one in every if fnmatchcase(one.name, rest[0])]
            if not elements:
                names = [one.name for one in every if one.name]
                raise UsageError(
                    f"{self.path} has no {kind} {rest[0]!r}{suggest(rest[0], names)} it has {one_of(names)}"
                )
        else:
            raise UsageError(
                f"{field!r} is not a field; write KIND/NAME/ATTRIBUTE with one of {one_of(_KINDS)}, or option/ATTRIBUTE"
            )
        attribute, index = rest[1] if len(rest) > 1 else "", rest[2] if len(rest) == 3 else None
        if attribute == "mass" and any(getattr(one, "explicitinertial", 1) == 0 for one in elements):
            raise UsageError(
                f"{self.path}: {field} has no effect, since the geoms give the body its mass; "
                f"name the mass of a geom, geom/NAME/mass"
            )
        return [(one, attribute, self._index(one, field, attribute, index)) for one in elements]

    def _index(self, holder: Any, field: str, attribute: str, index: str | None) -> int | None:
        numbers = [
            name for name in dir(holder) if not name.startswith("_") and _numeric(getattr(holder, name))
        ]
        if attribute not in numbers:
            raise UsageError(
                f"{self.path}: {field} has no number {attribute!r}{suggest(attribute, numbers)} "
                f"the element has {one_of(numbers)}"
            )
        value = getattr(holder, attribute)
        if not isinstance(value, np.ndarray):
            if index is None:
                return None
            raise UsageError(f"{self.path}: {field}: {attribute} is one number, so leave out /{index}")
        if index is None or not index.isdecimal() or int(index) >= value.size:
            raise UsageError(
                f"{self.path}: {field}: {attribute} has {value.size} numbers; add an index from 0 to {value.size - 1}, "
                f"such as {'/'.join(field.split('/')[:3])}/0"
            )
        return int(index)


def differences(one: Any, other: Any) -> list[str]:
    """Return the names of the arrays of two compiled models that differ by more than rounding."""
    if (one.nq, one.nv, one.nu, one.nbody, one.ngeom) != (
        other.nq,
        other.nv,
        other.nu,
        other.nbody,
        other.ngeom,
    ):
        return ["sizes"]
    found = [] if np.allclose(one.opt.gravity, other.opt.gravity) else ["gravity"]
    for name in dir(one):
        mine = getattr(one, name, None) if not name.startswith("_") else None
        if isinstance(mine, np.ndarray) and mine.dtype == np.float64:
            scale = ROUNDING * np.abs(mine).max(initial=0.0)
            same = mine.shape == getattr(other, name).shape
            if not same or not np.allclose(mine, getattr(other, name), ROUNDING, scale, equal_nan=True):
                found.append(name)
    return found


def _numeric(value: object) -> bool:
    return isinstance(value, int | float) or (isinstance(value, np.ndarray) and value.dtype == np.float64)


def _broken(files: Iterable[Path]) -> str:
    """Return where an XML file is broken, which MuJoCo's message does not show; "" if each is XML."""
    for path in files:
        try:
            _ = ElementTree.parse(path) if path.suffix.lower() in (".xml", ".mjcf", ".urdf") else None
        except ElementTree.ParseError as error:
            return f"{path} is not XML: {error}"
    return ""


def _words(error: ValueError) -> str:
    """Return MuJoCo's message on one line."""
    words = " ".join(str(error).split()).removeprefix("Error: ")
    return words.partition(" The visual elements of the spec were discarded")[0]


def _drop_missing_visuals(spec: Any, path: Path, files: Sequence[Path]) -> None:
    """Remove meshes whose files are missing if only pictures need them; a UsageError names any other."""
    missing = {
        mesh.name or Path(mesh.file).stem: mesh
        for mesh in spec.meshes
        if mesh.file and not _is_there(mesh.file, files, spec.strippath)
    }
    if not missing:
        return
    for geom in [one for one in spec.geoms if one.meshname in missing]:
        collides = geom.contype or geom.conaffinity
        if collides or _gives_mass(spec, geom):
            name = missing[geom.meshname].file.removeprefix(spec.modelfiledir)
            use = "a collision needs it" if collides else "the body's mass comes from it"
            raise UsageError(
                f"{path}: the mesh file {name} is missing, and {use}; put it into {_folder(spec)}"
            )
        spec.delete(geom)
    for mesh in missing.values():
        spec.delete(mesh)


def _gives_mass(spec: Any, geom: Any) -> bool:
    """Return whether the inertia of a body that can move comes from a geom."""
    body: Any = geom.parent
    low, high = spec.compiler.inertiagrouprange
    own = geom.density if np.isnan(geom.mass) else geom.mass
    if body.explicitinertial or not low <= geom.group <= high or own == 0.0:
        return False
    while body is not None and not body.joints:
        body = body.parent
    return body is not None


def _folder(spec: Any) -> Path:
    return Path(spec.modelfiledir) / spec.meshdir


def _is_there(file: str, files: Sequence[Path], strips: bool) -> bool:
    """Return whether a mesh is among the files of the model, also of one that it attaches."""
    parts = (PureWindowsPath(file).name,) if strips else PurePath(file).parts[PurePath(file).is_absolute() :]
    return any(path.parts[-len(parts) :] == parts for path in files)
