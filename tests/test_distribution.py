"""A message about a missing package has the right ``pip install`` command, whatever an extra is called."""

import ast
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from importlib.metadata import PathDistribution
from pathlib import Path

import pytest
from packaging.markers import default_environment
from packaging.requirements import Requirement

import s2r_spec
from s2r_spec.base import distribution
from s2r_spec.base.distribution import install_command
from s2r_spec.errors import MissingPackageError, UsageError, require
from tests.errors import states

ROOT = Path(__file__).parents[1]
SOURCES = [path for name in ("s2r_spec", "backends") for path in sorted((ROOT / name).rglob("*.py"))]


def metadata(folder: Path, renamed: dict[str, str] | None = None) -> PathDistribution:
    """Return the distribution that pyproject.toml declares, with some extras under other names."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    lines = [f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n"]
    lines += [f"Requires-Dist: {line}\n" for line in project["dependencies"]]
    for extra, requirements in project["optional-dependencies"].items():
        name = (renamed or {}).get(extra, extra)
        lines.append(f"Provides-Extra: {name}\n")
        for line in requirements:
            requirement, _, marker = line.partition(";")
            condition = f"({marker}) and " if marker else ""
            lines.append(f"Requires-Dist: {requirement} ; {condition}extra == '{name}'\n")
    place = folder / "s2r_spec-0.dist-info"
    place.mkdir()
    (place / "METADATA").write_text("".join(lines))
    return PathDistribution(place)


@pytest.fixture
def declared(tmp_path):
    return metadata(tmp_path)


def needed() -> Iterator[tuple[str, ...]]:
    """Yield the modules of every message about packages that are not installed."""
    for path in SOURCES:
        text = path.read_text(encoding="utf-8")
        if not re.search(r"\b(require|library|MissingPackageError)\(", text):
            continue
        tree = ast.parse(text)
        lists = {
            node.targets[0].id: [element.value for element in node.value.elts]
            for node in tree.body
            if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name)
            if isinstance(node.value, ast.Tuple)
            and all(isinstance(element, ast.Constant) for element in node.value.elts)
        }
        for node in ast.walk(tree):
            match node:
                case ast.Call(func=ast.Name("require"), args=[_, ast.Starred(ast.Name(name))]):
                    yield tuple(lists[name])
                case ast.Call(func=ast.Name("require"), args=[_, *names]):
                    yield tuple(name.value for name in names)
                case ast.Call(func=ast.Name("library"), args=[name, _]):
                    yield (name.value,)
                case ast.Raise(exc=ast.Call(func=ast.Name("MissingPackageError"))) if "_MODULES" in lists:
                    yield from ((name,) for name in lists["_MODULES"])


MESSAGES = sorted(set(needed()))


def test_the_messages_are_found():
    found = {name for modules in MESSAGES for name in modules}
    assert found >= {
        "PIL",
        "distributed",
        "h5py",
        "jinja2",
        "matplotlib",
        "mujoco",
        "pyarrow",
        "pyulog",
        "rosbags.highlevel",
    }


@pytest.mark.parametrize("modules", MESSAGES, ids=" ".join)
def test_a_message_names_an_extra_that_brings_the_packages(modules, declared):
    command = install_command(modules, declared)
    wanted = Requirement(command.removeprefix("pip install ").strip("'"))
    assert wanted.name == declared.metadata["Name"]
    assert len(wanted.extras) <= 1
    (extra,) = wanted.extras or {""}
    brought = {
        requirement.name
        for requirement in map(Requirement, declared.requires)
        if not requirement.marker or requirement.marker.evaluate({**default_environment(), "extra": extra})
    }
    assert {distribution.package(module) for module in modules} <= brought


def test_no_message_has_a_command_of_its_own():
    for path in SOURCES:
        if path.name != "distribution.py":
            text = path.read_text(encoding="utf-8")
            tree = ast.parse(text if "pip install" in text else "")
            texts = [node.value for node in ast.walk(tree) if isinstance(node, ast.Constant)]
            assert not [text for text in texts if isinstance(text, str) and "pip install" in text], path


@pytest.mark.parametrize(
    ("modules", "extra"),
    [
        (["matplotlib"], "pictures"),
        (["jinja2", "matplotlib"], "report"),
        (["rosbags.highlevel"], "logs"),
        (["distributed"], "dask"),
        (["piqp"], "sim"),
        (["mujoco"], "mujoco"),
        (["mujoco", "piqp"], "sim"),
    ],
)
def test_a_renamed_extra_has_its_new_name_in_the_command(modules, extra, declared, tmp_path):
    assert install_command(modules, declared) == f"pip install 's2r-spec[{extra}]'"
    (tmp_path / "renamed").mkdir()
    renamed = metadata(tmp_path / "renamed", {extra: "anew"})
    assert install_command(modules, renamed) == "pip install 's2r-spec[anew]'"


def test_a_package_that_is_required_anyway_needs_no_extra(declared):
    assert install_command(["numba"], declared) == "pip install s2r-spec"


def test_a_package_without_an_extra_is_named_itself(declared):
    assert install_command(["plotly"], declared) == "pip install plotly"


def test_without_metadata_the_packages_are_named():
    assert install_command(["pinocchio", "PIL"], None) == "pip install pillow pin"
    code = "from s2r_spec.base import errors; errors.require('x needs', 'no_such_module')"
    # -S: no site-packages, as with a source tree on the path of an interpreter without s2r.
    done = subprocess.run(
        [sys.executable, "-S", "-c", code],
        cwd=ROOT,
        env={"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
    )
    assert states(done.stderr, "UsageError", "pip install no_such_module")


def test_the_extra_of_a_backend_is_one_of_its_own_distribution(toy):
    assert states(str(MissingPackageError("needy", "no_such_module")), "pip install no_such_module")
    own = distribution.find_own()
    assert distribution.find_provider("sim").metadata["Name"] == own.metadata["Name"]
    assert distribution.find_provider("needy").metadata["Name"] == "s2r-toy"


def test_the_package_has_the_version_of_its_metadata(monkeypatch):
    assert s2r_spec.__version__ == distribution.find_own().version
    monkeypatch.setattr(distribution, "find_own", lambda: None)
    assert s2r_spec.__version__ == distribution.UNKNOWN


def test_what_is_installed_is_not_missing():
    require("a test needs", "json")
    with pytest.raises(UsageError):
        require("a test needs", "json", "no_such_module")
