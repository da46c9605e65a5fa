"""A robot that was read from its files: its channels, its parameters, the files that decide a trace, and their hash."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from s2r_mujoco.arrays import FloatArray
from s2r_mujoco.channels import channels_of
from s2r_mujoco.deploy import of_metadata, read_deployment
from s2r_mujoco.deploy.record import Deployment
from s2r_mujoco.description import read_description
from s2r_mujoco.effects.catalogue import catalogue
from s2r_mujoco.effects.kinds import at_rest, kinds_of
from s2r_mujoco.effects.physics import VARIANTS, Edit, Physics
from s2r_mujoco.failure import Failures
from s2r_mujoco.model import FieldChange, ModelFile
from s2r_mujoco.observation import Memory, Observer, Part, Parts
from s2r_mujoco.own_effects import OwnEffects
from s2r_mujoco.parameters import parameters_of
from s2r_mujoco.plan import Plan, make_plan
from s2r_mujoco.rollout import Record
from s2r_mujoco.start import floors, start_pose
from s2r_policy import Policy, open_policy
from s2r_spec.backend import read_code
from s2r_spec.effects import Choice, ModelEffect, add_effects, choose
from s2r_spec.errors import UsageError, require
from s2r_spec.trace import Trace

STABLE = 2.0
"""Definition: kd·dt/M from which an explicit damping is unstable: a step multiplies a velocity by 1 − kd·dt/M."""
KEPT = 4
"""Budget: compiled models that a process keeps, one for each test with other fields."""


class Robot:
    """A robot from its files. Making it reads every file, compiles the model, and runs no code of the user."""

    def __init__(self, path: Path, loop: str = "", held: bool = False) -> None:
        """Read the files; ``held`` leaves out the policy and fixes the base, as if a rig held the robot in the air."""
        self.description = read_description(path, loop)
        self.name = path.name
        stated = self._stated(self.description.table.deploy)
        self.description = self.description.completed(stated)
        self.own_effects = self._own_effects(strict=not held)
        table = self.description.table
        self.policy = self._open_policy(table.policy) if table.policy else None
        self.deployment = stated if table.deploy else self._of_metadata()
        self.held = held or not table.policy
        if self.held:
            self.description, self.policy = self.description.held(), None
            self.deployment = self.deployment.without_observation()
            table = self.description.table
        self.file = self._model_file()
        model = self.file.compile()
        self.model = model
        self.plan = self._with_stable_gains(make_plan(self.description, self.deployment, model))
        _ = self.pose  # refuses a joint that the model lacks
        if not (self.acts or self.policy or self.plan.law.has_target.any()):
            raise UsageError(
                f'{self.name} names no controller; write policy = "policy.onnx" or "control.py:act", or, for protocols '
                f"of joints alone, gains in `action.stiffness` and `action.damping`"
            )
        if self.plan.root >= 0 and not floors(model):
            raise UsageError(
                f"{self.name}: the model has a free base and no floor to stand on; write floor = true, or name a scene "
                f"with a floor in `model`"
            )
        self.parts = self._known_parts()
        self.refuse_width(self.parts or ())
        width = None if self.policy is None else self._width
        columns = tuple(f"{i}" for i in range(width)) if width else ()
        self.computed = channels_of(
            model, self.plan, columns, trained=self.policy is not None, acts=self.acts
        )
        self.channels = tuple(one.channel for one in self.computed)
        self.failures = Failures(table.failure, self.channels, self.name)
        self.failures.check()
        self.parameters = parameters_of(self.description, self.plan, self.file, model)
        if not held:  # each rollout in the air brings those that the robot also has there
            _ = self.stated  # refuses an effect that the catalogue lacks

    # -- files ----------------------------------------------------------------------------------------------------

    def _open_policy(self, name: str) -> Policy | None:
        """Return the trained policy; None for a controller in Python."""
        if name.endswith(".py"):
            raise UsageError(
                f'{self.name}: policy = "{name}" names no function in the file; write "{name}:act"'
            )
        return None if ".py:" in name else open_trained(self.description.beside(name))

    def _stated(self, name: str) -> Deployment:
        """Return what the deploy file says; nothing without one."""
        return read_deployment(self.description.beside(name)) if name else Deployment(self.name)

    def _of_metadata(self) -> Deployment:
        metadata = {} if self.policy is None else self.policy.metadata
        return of_metadata(metadata, self.description.table.policy) or Deployment(self.name)

    def _own_effects(self, strict: bool) -> OwnEffects:
        """Return what the user's file says of the catalogue; nothing without one."""
        name = self.description.table.catalogue
        return OwnEffects.read(self.description.beside(name), strict) if name else OwnEffects()

    def _model_file(self) -> ModelFile:
        table = self.description.table
        if not table.model:
            raise UsageError(f'{self.name} names no model; write model = "scene.xml"')
        timestep = table.timestep or self.deployment.timestep
        fields = tuple((FieldChange(name), value) for name, value in table.fields.items())
        path = self.description.beside(table.model)
        return ModelFile(path, table.floor, timestep, table.motors, self.held, fields)

    @property
    def acts(self) -> bool:
        """Whether a Python function controls the robot."""
        return ".py:" in self.description.table.policy

    @property
    def code_names(self) -> tuple[str, ...]:
        """Names of the user's own code in the file: the terms, then the controller."""
        names = [term.name for term in self.plan.terms if ".py:" in term.name]
        return (*names, *([self.description.table.policy] if self.acts else []), *self.own_effects.code_names)

    @cached_property
    def code_files(self) -> tuple[Path, ...]:
        """The Python files of the user that run, with those of their folder that they import."""
        folder = self.description.path.parent
        return tuple(dict.fromkeys(path for name in self.code_names for path in read_code(name, folder)[1]))

    @cached_property
    def files(self) -> tuple[Path, ...]:
        """Every file that decides a trace: robot file, model, deploy files, policy, the user's code."""
        policy = () if self.policy is None else self.policy.files
        stated = (self.description.path, *self.own_effects.files, *self.deployment.files)
        return (*stated, *self.file.files, *policy, *self.code_files)

    def digest(self, extra: str) -> str:
        """Return the hash over all files, versions and this package's source."""
        total = self._content.copy()
        total.update(extra.encode())
        return total.hexdigest()

    @cached_property
    def _content(self) -> Any:
        """Hash of all files, read once: a process has thousands of backends of one robot, each with other effects."""
        total = hashlib.sha256()
        total.update(f"mujoco {version('mujoco')} numpy {version('numpy')}".encode())
        total.update(b"" if self.policy is None else self.policy.digest.encode())
        for name in self.code_names:
            total.update(read_code(name, self.description.path.parent)[0].encode())
        here = Path(__file__).parent
        sources = [
            path for path in sorted(here.rglob("*.py")) if not _ONLOOKERS & {path.name, path.parent.name}
        ]
        own = self.own_effects.files
        for path in (self.description.path, *own, *self.deployment.files, *self.file.files, *sources):
            total.update(path.read_bytes())
        return total

    def _with_stable_gains(self, plan: Plan) -> Plan:
        """Return a plan with gains inside of MuJoCo where explicit ones are unstable and the file chooses neither."""
        self.plan = plan
        law, chosen = plan.law, self.description.table.action.pd
        if law.pd != "explicit" or chosen or self.damping_ratio(law.damping).max() < STABLE:
            return plan
        return replace(plan, law=replace(law, pd="implicit"))

    @cached_property
    def pose(self) -> FloatArray:
        """(nq,) positions at t = 0, without noise."""
        return start_pose(self.model, self.plan, self.description.table.start, self.name)

    def damping_ratio(self, damping: FloatArray) -> FloatArray:
        """Return (n,) kd·dt/M of the joints of the policy at the start pose.

        1/M is the diagonal of the inverse of the mass matrix: the acceleration of a joint by its own torque alone, with
        all other joints free.
        """
        _, matrix = at_rest(self.model, self.pose)
        dof = self.plan.joints.dof
        ratio: FloatArray = damping * self.model.opt.timestep * np.diag(np.linalg.inv(matrix))[dof]
        return ratio

    # -- declarations ---------------------------------------------------------------------------------------------

    def _known_parts(self) -> tuple[Part, ...] | None:
        """Return the parts of the observation; None if a term of the user's own has a width that only a call tells."""
        if self.policy is None:
            return ()
        if not self.plan.terms:
            raise UsageError(
                f'{self.name}: no file lists the terms of the observation; write observation = ["base_ang_vel", …]'
            )
        if any(".py:" in term.name for term in self.plan.terms):
            return None
        data, memory = mujoco.MjData(self.model), Memory(np.zeros(3), np.zeros(len(self.plan.law.moved)))
        return Parts(self.plan, self.model, data, memory).of(self.plan.terms, {})

    @property
    def _width(self) -> int | None:
        if self.parts:
            return Observer(self.parts, self.plan).width
        return self.policy.width if self.policy else None

    def refuse_width(self, parts: tuple[Part, ...]) -> None:
        """Refuse a policy whose input or output has another width than the files say; () for unknown terms."""
        if self.policy is None:
            return
        width, wanted = sum(part.width * part.term.history for part in parts), self.policy.width
        name = self.description.table.policy
        if parts and wanted is not None and wanted != width:
            raise UsageError(
                f"{name} takes {wanted} numbers, but the observation has {width}: {terms(parts)}"
            )
        moved = len(self.plan.law.moved)
        if not moved:
            raise UsageError(
                f"{name}: no actuator of the model drives a hinge or a slide, so the policy's outputs have no meaning; "
                f'write a controller in Python, policy = "control.py:act"'
            )
        if self.policy.outputs is not None:
            self.refuse_outputs(self.policy.outputs)

    def refuse_outputs(self, outputs: int) -> None:
        """Refuse a policy that returns another number than that of the joints that it moves."""
        moved = len(self.plan.law.moved)
        if outputs != moved:
            raise UsageError(
                f"{self.description.table.policy} returns {outputs} numbers, but the files name {moved} joints: "
                f"{', '.join(self.plan.joints.names)}; list those of the policy in `action.joints`"
            )

    def trace(self, record: Record, meta: Mapping[str, Any]) -> Trace:
        """Return the whole record as a trace."""
        channels = {one.channel.name: one.of(record) for one in self.computed}
        units = {one.name: one.unit for one in self.channels}
        times = self.plan.step * np.arange(len(record), dtype=np.float64)
        return Trace(times, channels, units, dict(meta))

    def changes(self, values: Mapping[str, float]) -> dict[FieldChange, float]:
        """Return the changes of the model's fields in a test."""
        return {
            one.change: values[name]
            for name, one in self.description.table.parameters.items()
            if one.field and values[name] != self.parameters[name].declared.default
        }

    @property
    def catalogue(self) -> tuple[ModelEffect, ...]:
        """The effects that the simulator leaves out: by the fields of the model, and by the user's file."""
        return self._catalogue[0]

    @cached_property
    def _catalogue(self) -> tuple[tuple[ModelEffect, ...], tuple[Edit, ...]]:
        """The catalogue, and how its effects of the user's own change the model's description."""
        kinds = kinds_of(self.model, self.own_effects.kinds_of(self.model))
        effects = catalogue(self.model, self.plan, self.pose, kinds, acts=self.acts, held=self.held)
        return self.own_effects.changed(effects, self.file, self.model)

    @cached_property
    def stated(self) -> Choice:
        """The effects that the robot file states, which it has in every rollout."""
        table = self.description.table.effects
        try:
            return choose(self.name, self.catalogue, (), table) if table else ()
        except UsageError as error:
            raise UsageError(f"{self.name}: effects: {error}") from None

    def physics(self, added: Choice, variant: str = "") -> Physics:
        """Return what effects change, in the simulator of a variant."""
        changes: Mapping[str, Any] = VARIANTS[variant] if variant else {}
        effects, edits = self._catalogue
        amounts = np.concatenate([np.zeros(0), *(one.nominal for one in edits)])
        plain = replace(Physics.of(self.model), amounts=amounts, edits=edits, **changes)
        return add_effects(plain, effects, added)

    @property
    def reach(self) -> float:
        """Distance between the root and the far end of the farthest moving geom at the start pose [m]."""
        model, data = self.model, mujoco.MjData(self.model)
        data.qpos[:] = self.pose
        mujoco.mj_kinematics(model, data)
        moving = model.body_weldid[model.geom_bodyid] != 0
        away = np.linalg.norm(data.geom_xpos - data.xpos[max(self.plan.root, 0)], axis=1) + model.geom_rbound
        return float(away[moving].max(initial=0.1))


_ONLOOKERS = {"new.py", "pictures.py", "preflight.py", "found"}
"""Definition: source files, and a folder of them, without influence on a trace."""


def open_trained(path: Path) -> Policy:
    """Return a trained policy; a UsageError about a missing package names the extra of robot files."""
    if path.suffix.lower() == ".onnx":
        require("a policy in an ONNX file needs", "onnxruntime", "mujoco")
    return open_policy(path)


def terms(parts: tuple[Part, ...]) -> str:
    """Return the terms of an observation with their widths, for messages."""
    return ", ".join(f"{p.name} {p.width * p.term.history}" for p in parts)
