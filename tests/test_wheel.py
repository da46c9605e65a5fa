"""The wheel works without the repository: an environment of its own has it, and finds only its dependencies here."""

import json
import os
import re
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
import zipfile
from pathlib import Path

import jsonschema
import pytest

from s2r_spec.report.records.schema import schema
from tests.errors import states

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
QUICK_START = re.search(
    r"<!-- output of: s2r (monitor .*?) -->\n```text\n(.*?)```", (ROOT / "README.md").read_text(), re.S
)


def run(*words: str | Path, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a program in a folder, without the repository on its path."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    return subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True, timeout=120)


def build(kind: str, source: Path, into: Path) -> Path:
    """Build a distribution, and return its file."""
    done = run(sys.executable, "-m", "hatchling", "build", "-t", kind, "-d", into, folder=source)
    assert done.returncode == 0, done.stderr
    (made,) = into.glob({"wheel": "*.whl", "sdist": "*.tar.gz"}[kind])
    return made


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    return build("wheel", ROOT, tmp_path_factory.mktemp("dist"))


@pytest.fixture(scope="module")
def s2r(wheel, tmp_path_factory):
    """The installed command, in an empty folder.

    Its environment finds the dependencies through a ``.pth`` file. Such files of the tests' own environment, among them
    the one of an editable installation, are not read.
    """
    home = tmp_path_factory.mktemp("home")
    place = home / "venv"
    assert run(sys.executable, "-m", "venv", "--without-pip", place, folder=home).returncode == 0
    pip = [
        sys.executable,
        "-m",
        "pip",
        "--python",
        place,
        "install",
        "--no-deps",
        "--no-index",
        "--no-compile",
    ]
    done = run(*pip, wheel, folder=home)
    assert done.returncode == 0, done.stderr
    (packages,) = place.glob("lib/python*/site-packages")
    outside = {sysconfig.get_path(kind) for kind in ("purelib", "platlib")}
    (packages / "dependencies.pth").write_text("".join(f"{path}\n" for path in sorted(outside)))
    folder = home / "empty"
    folder.mkdir()
    return lambda *words: run(place / "bin" / "s2r", *words, folder=folder)


def test_the_quick_start_of_the_readme_needs_no_repository(s2r):
    written = s2r("examples").stdout.split()
    words, shown = QUICK_START.groups()
    assert {path for path in words.split() if "/" in path} <= set(written)
    done = s2r(*words.split())
    assert done.stdout == shown
    assert done.returncode == 1  # the example fails


def test_examples_are_the_folder_of_the_repository_and_overwrite_nothing(s2r):
    done = s2r("examples", "tried", "--json")
    found = json.loads(done.stdout)
    jsonschema.validate(found, schema("s2r.examples/1"))
    kept = {path.relative_to(ROOT / "specs").as_posix() for path in (ROOT / "specs").rglob("*.*")}
    assert set(found["files"]) == {f"tried/{name}" for name in kept}
    again = s2r("examples", "tried")
    assert again.returncode == 2
    assert states(again.stderr, "tried/a1_velocity.stl", "FOLDER")
    assert not again.stdout


def test_it_has_its_pages_its_version_and_its_backends(s2r):
    pages = {
        path.relative_to(ROOT / "docs").with_suffix("").as_posix()
        for ending in ("md", "ipynb")
        for path in (ROOT / "docs").rglob(f"*.{ending}")
    }
    assert {line.split()[0] for line in s2r("docs").stdout.splitlines()} == pages
    assert s2r("--version").stdout == f"s2r {PROJECT['version']}\n"
    offered = PROJECT["entry-points"]["s2r.backends"]
    assert {line.split()[0] for line in s2r("backends").stdout.splitlines()} >= set(offered)


def test_the_wheel_has_every_file_that_is_read_at_run_time(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    tree = {path.relative_to(ROOT / "backends").as_posix() for path in (ROOT / "backends").rglob("*.*")}
    tree |= {path.relative_to(ROOT).as_posix() for path in (ROOT / "s2r_spec").rglob("*.*")}
    tree |= {f"s2r_spec/data/{path.relative_to(ROOT)}" for path in (ROOT / "docs").rglob("*.*")}
    assert {name for name in tree if "__pycache__" not in name} <= names
    assert {f"{name.split('/')[0]}/py.typed" for name in names if name.endswith("__init__.py")} <= names


def test_the_page_of_an_index_has_no_link_into_the_repository(wheel):
    with zipfile.ZipFile(wheel) as file:
        (name,) = (name for name in file.namelist() if name.endswith("dist-info/METADATA"))
        text = file.read(name).decode()
    assert "# s2r" in text
    assert not re.findall(r"\]\((?!https?://|#)[^)\s]+\)", text)


@pytest.mark.dev
def test_an_index_takes_both_and_the_source_distribution_makes_the_same_wheel(wheel, tmp_path):
    pytest.importorskip("twine")
    source = build("sdist", ROOT, tmp_path)
    checked = run(sys.executable, "-m", "twine", "check", "--strict", wheel, source, folder=tmp_path)
    assert checked.returncode == 0, checked.stdout
    with tarfile.open(source) as file:
        file.extractall(tmp_path, filter="data")
    again = build("wheel", tmp_path / source.name.removesuffix(".tar.gz"), tmp_path / "again")
    assert again.read_bytes() == wheel.read_bytes()
