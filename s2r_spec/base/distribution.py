"""The distribution that installed s2r: its name, its version, and the extra that brings a package.

The installed metadata answer each question, so that no message names an extra that pyproject.toml has renamed.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from importlib.metadata import Distribution

BACKENDS = "s2r.backends"
"""Definition: entry-point group in which a distribution offers backends."""
FILES = "s2r.files"
"""Definition: entry-point group in which a distribution opens files with an ending as backends."""
UNKNOWN = "0+unknown"
"""Definition: version of a source tree on the path, which has no metadata."""
_PACKAGES = {"PIL": "pillow", "pinocchio": "pin", "yaml": "pyyaml"}
"""Definition: module → package, where the names differ. A package that is not installed cannot tell."""


@cache
def find_own() -> Distribution | None:
    """Return the distribution with the command ``s2r`` of this package; None for a source tree on the path."""
    return _provider("console_scripts", "s2r", f"{__name__.partition('.')[0]}.")


def find_provider(backend: str) -> Distribution | None:
    """Return the distribution that offers a backend of this name, or opens a file of it; None if there is none."""
    return _provider(BACKENDS, backend) or _provider(FILES, backend.rpartition(".")[2])


def version() -> str:
    """Return the version of s2r, such as ``0.1.0``."""
    distribution = find_own()
    return UNKNOWN if distribution is None else distribution.version


def package(module: str) -> str:
    """Return the name of the package on the index that has a module: ``pillow`` for ``PIL.Image``."""
    top = module.partition(".")[0]
    return _PACKAGES.get(top, top)


def install_command(modules: Iterable[str], distribution: Distribution | None) -> str:
    """Return the command that installs the packages of some modules: ``pip install 's2r-spec[logs]'``.

    It names the distribution's smallest extra that requires all of them. Without such an extra, or without metadata, it
    names the packages themselves.
    """
    packages = sorted({package(module) for module in modules})
    extra = None if distribution is None else _extra(distribution, packages)
    if distribution is None or extra is None:
        return f"pip install {' '.join(packages)}"
    name = distribution.metadata["Name"]
    return f"pip install '{name}[{extra}]'" if extra else f"pip install {name}"


def _provider(group: str, name: str, prefix: str = "") -> Distribution | None:
    from importlib.metadata import entry_points

    points = entry_points(group=group, name=name)
    return next((point.dist for point in points if point.value.startswith(prefix)), None)


def _extra(distribution: Distribution, packages: Iterable[str]) -> str | None:
    """Return the smallest extra that requires all packages, "" if the distribution does so without any."""
    from packaging.requirements import Requirement
    from packaging.utils import canonicalize_name

    requirements = [Requirement(line) for line in distribution.requires or ()]
    names = {canonicalize_name(name) for name in packages}
    suitable = {}
    for extra in ("", *(distribution.metadata.get_all("Provides-Extra") or ())):
        brought = {
            canonicalize_name(requirement.name)
            for requirement in requirements
            if requirement.marker is None or requirement.marker.evaluate({"extra": extra})
        }
        if names <= brought:
            suitable[extra] = len(brought)
    return min(suitable, key=lambda extra: (suitable[extra], extra), default=None)
