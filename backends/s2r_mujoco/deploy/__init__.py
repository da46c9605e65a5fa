"""Read the deploy files of the field: what a trained policy expects of the robot's controller.

:func:`read_deployment` recognises the format of a file by its keys, :func:`of_metadata` reads what exporters write
into an ONNX file. The files come from strangers; see :mod:`s2r_mujoco.deploy.yaml` for the limits of what is read.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from s2r_mujoco.deploy import rl_gym, rl_sar, unitree
from s2r_mujoco.deploy.onnx_metadata import of_metadata as of_metadata
from s2r_mujoco.deploy.record import Deployment
from s2r_mujoco.deploy.yaml import read
from s2r_spec.errors import UsageError, one_of

FORMATS = (
    "deploy.yaml of unitree_rl_lab and unitree_rl_mjlab (joint_ids_map, observations)",
    "config.yaml of rl_sar (a policy with num_of_dofs, default_dof_pos)",
    "yaml of unitree_rl_gym (default_angles, kps, num_actions)",
)
"""Definition: the formats that are read, each with the keys that tell it."""


def read_deployment(path: Path) -> Deployment:
    """Return what a deploy file says; the path may end in ``#key``, which chooses one of several policies.

    Raises:
        UsageError: the file cannot be read, has no known format, has several policies and no key chooses one, or a key
            of it is missing or wrong.
    """
    file, key = split(path)
    return of_values(read(file), file, key)


def of_values(values: Any, file: Path, key: str = "") -> Deployment:
    """Return what the values of a deploy file say; see :func:`read_deployment`."""
    if isinstance(values, Mapping):
        if rl_sar.policies(values):
            return rl_sar.deployment(values, file, key)
        if key:
            raise UsageError(f"{file} has no policy {key!r} to choose; leave out '#{key}'")
        if unitree.fits(values):
            return unitree.deployment(values, file)
        if rl_gym.fits(values):
            return rl_gym.deployment(values, file)
    keys = one_of(values) if isinstance(values, Mapping) else "(none)"
    raise UsageError(f"{file} has no known format; it has the keys {keys}. Known are: {'; '.join(FORMATS)}")


def split(path: Path) -> tuple[Path, str]:
    """Return the file and the key behind its last ``#``; a key may have a slash, as ``b2/robot_lab``."""
    name, mark, key = str(path).rpartition("#")
    return (Path(name), key) if mark and not path.exists() else (path, "")
