"""Read the deploy files of the field: what a trained policy expects of the robot's controller.

:func:`read_deployment` recognises the format of a file by its keys. The files come from strangers; see
:mod:`s2r_mujoco.deploy.yaml` for the limits of what is read.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from s2r_mujoco.deploy import unitree
from s2r_mujoco.deploy.record import Deployment as Deployment
from s2r_mujoco.deploy.record import Term as Term
from s2r_mujoco.deploy.yaml import read
from s2r_spec.errors import UsageError, one_of


def read_deployment(path: Path) -> Deployment:
    """Return what a deploy file says; the path may end in ``#key``, which chooses one of several policies.

    Raises:
        UsageError: the file cannot be read, has no known format, or a key of it is missing or wrong.
    """
    name, _, _key = path.name.partition("#")
    file = path.with_name(name)
    values = read(file)
    if isinstance(values, Mapping) and unitree.fits(values):
        return unitree.deployment(values, file)
    keys = one_of(values) if isinstance(values, Mapping) else "(none)"
    raise UsageError(f"{file} has no known format; its keys are {keys}")
