"""Which modules are mutated, and by whose tests they must be caught."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Part:
    """A folder, or a few files of one.

    Attributes:
        sources: folders and files, relative to the repository.
        tests: the folders and files of tests that state what the part does.
        early: modules of our own that import none of the part, and are imported once for all mutants.
        whole: files of which every mutant is tried; of the others a random sample.
    """

    sources: tuple[str, ...]
    tests: tuple[str, ...]
    early: tuple[str, ...]
    whole: frozenset[str] = frozenset()

    def modules(self, root: Path) -> list[str]:
        """Return the paths of the modules, relative to the repository."""
        found = []
        for source in self.sources:
            path = root / source
            found += sorted(path.rglob("*.py")) if path.is_dir() else [path]
        return [str(module.relative_to(root)) for module in found if module.name != "__init__.py"]


PARTS = {
    "certify": Part(
        ("s2r_spec/certify",),
        ("tests/certify",),
        ("torch", "gpytorch", "s2r_spec.backend", "s2r_spec.space", "s2r_spec.rollouts.runner"),
        frozenset({"confidence.py", "rounding.py"}),
    ),
    "robustness": Part(
        ("s2r_spec/robustness",),
        ("tests/robustness", "tests/test_instants.py"),
        ("torch", "s2r_spec.lang.parsing"),
        frozenset({"kernels.py", "windows.py"}),
    ),
    "guard": Part(
        (
            "backends/s2r_a1/guard/limits.py",
            "backends/s2r_a1/guard/leg.py",
            "backends/s2r_a1/guard/states.py",
        ),
        ("tests/a1/test_limits.py", "tests/a1/test_states.py"),
        (
            "s2r_spec.backend",
            "s2r_spec.rollouts.runner",
            "s2r_a1.wire",
            "s2r_a1.remote",
            "s2r_sim.controller.gains",
            "s2r_sim.robot.leg_kinematics",
        ),
        frozenset({"limits.py"}),
    ),
}
