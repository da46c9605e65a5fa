"""Count what a reader of the package sees first: ``python -m tests.rooms [CHECKOUT]``.

A room is a folder of ``s2r_spec``, and a loose file is a module beside them. An arrow leads from one of them to another
that it imports; a floor is one more than the highest floor below it.
"""

import ast
import sys
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]


@cache
def imported(path: Path, package: str = "s2r_spec") -> set[str]:
    """Return every module of a package that a file imports, at any depth of nesting."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return {name.split(".")[1] for name in found if name.startswith(f"{package}.")}


def rooms(package: Path) -> set[str]:
    """Return the folders of a package that hold modules."""
    return {path.parent.name for path in package.glob("*/*.py")}


def loose(package: Path) -> set[str]:
    """Return the modules beside the folders, without the package itself."""
    return {path.stem for path in package.glob("*.py")} - {"__init__"}


def arrows(package: Path) -> dict[str, set[str]]:
    """Return room or loose file → those that it imports."""
    names = rooms(package) | loose(package)
    found: dict[str, set[str]] = {name: set() for name in names}
    for path in set(package.rglob("*.py")) - {package / "__init__.py"}:
        own = path.relative_to(package).parts[0].removesuffix(".py")
        found[own] |= imported(path, package.name) & names - {own}
    return found


def floors(below: dict[str, set[str]]) -> list[set[str]]:
    """Return the floors from the ground, without those that import each other in a circle."""
    found: list[set[str]] = []
    while ready := {
        name for name in below if below[name] <= (done := set().union(*found)) and name not in done
    }:
        found.append(ready)
    return found


if __name__ == "__main__":
    package = (Path(sys.argv[1]) if sys.argv[1:] else ROOT) / "s2r_spec"
    below = arrows(package)
    levels = floors(below)
    print(f"{len(rooms(package))} rooms, {len(loose(package))} loose files, {len(levels)} floors")
    print(
        f"{sum(map(len, below.values()))} arrows, and {len(below) - sum(map(len, levels))} of all in a circle"
    )
    for number, names in reversed([*enumerate(levels, 1)]):
        print(f"{number:3}  {' '.join(sorted(names))}")
