"""Imports go one way, and the light modules stay light."""

import ast
import importlib
import json
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

import s2r_spec as s2r
from s2r_spec.cli.commands import EXAMPLES
from tests.rooms import arrows, floors, imported, loose, rooms

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "s2r_spec"
SIMULATOR = PACKAGE.parent / "backends" / "s2r_sim"

# A module may import those on its own line and below.
LAYERS = [
    {"__main__"},
    {"cli"},
    {"report"},
    {"diagnose"},
    {"certify", "conformance", "pytest_plugin"},
    {"machine", "testing"},
    {"runs"},
    {"attribution", "effects", "protocols", "recordings"},
    {"backend", "spec"},
    {"logs", "robustness"},
    {"errors", "lang", "space", "trace", "workers"},
    {"base", "compiled"},
]
ROBOTS = SIMULATOR.parent / "s2r_mujoco"
ROBOT_LAYERS = [
    {"backend"},
    {"found", "held", "interface", "new", "pictures", "preflight"},
    {"running"},
    {"robot"},
    {"own_effects"},
    {"parameters"},
    {"channels", "failure"},
    {"rollout"},
    {"effects"},
    {"drive", "observation", "start"},
    {"law", "plan"},
    {"joints"},
    {"description", "model"},
    {"fixed_base", "model_files", "toml"},
    {"markup"},
    {"deploy"},
    {"arrays"},
]
SIMULATOR_LAYERS = [
    {"twins"},
    {"backend"},
    {"residuals"},
    {"pictures", "protocols", "rollout", "variants"},
    {"settings", "parameters"},
    {"effects"},
    {"plant"},
    {"controller"},
    {"robot"},
]


PACKAGES = {PACKAGE: LAYERS, SIMULATOR: SIMULATOR_LAYERS, ROBOTS: ROBOT_LAYERS}


def modules() -> list[tuple[Path, Path]]:
    """Return (package, file) of every module that has a layer."""
    return [
        (package, path)
        for package in PACKAGES
        for path in sorted(package.rglob("*.py"))
        if path != package / "__init__.py"
    ]


def place(argument: Path) -> str:
    return str(argument.relative_to(PACKAGE.parent))


@pytest.mark.parametrize(("package", "path"), modules(), ids=place)
def test_imports_go_down(package, path):
    rank = {name: number for number, names in enumerate(PACKAGES[package]) for name in names}
    own = path.relative_to(package).parts[0].removesuffix(".py")
    assert own in rank, f"{own} has no layer: add it to the layers of {package.name}"
    upwards = {name for name in imported(path, package.name) & rank.keys() if rank[name] < rank[own]}
    assert not upwards, f"{path.name} imports upwards: {upwards}"


def test_the_package_stays_small_enough_to_look_through():
    """`python -m tests.rooms` prints these numbers, and which room stands on which."""
    below = arrows(PACKAGE)
    assert len(rooms(PACKAGE)) <= 17
    assert len(loose(PACKAGE)) <= 8
    assert {name for names in floors(below) for name in names} == {*below}, (
        "rooms import each other in a circle"
    )


def test_no_name_of_a_package_hides_one_of_its_folders():
    for path in PACKAGE.glob("*/*/__init__.py"):
        room, name = path.parts[-3:-1]
        folder = importlib.import_module(f"s2r_spec.{room}.{name}")
        assert getattr(sys.modules[f"s2r_spec.{room}"], name) is folder, f"{room}/{name}"


def test_only_methods_that_users_look_for_reach_upwards():
    """A method finds the work of a higher layer by name, when it is called; see `upper.py`."""
    found = {
        (place(path), name)
        for path in PACKAGE.rglob("*.py")
        for name in re.findall(r"\bupper\((\S+?)\)", path.read_text())
        if "from s2r_spec.base.upper import upper" in path.read_text()
    }
    assert found == {
        ("s2r_spec/diagnose/diagnosis.py", '"report.reason"'),
        ("s2r_spec/diagnose/diagnosis.py", '"report.advice"'),
        ("s2r_spec/base/result.py", "_FORMS"),
        ("s2r_spec/trace/trace.py", '"logs.formats.dataframe"'),
    }


def test_a_backend_imports_no_more_of_s2r_than_it_must():
    for path in (PACKAGE.parent / "backends").rglob("*.py"):
        assert imported(path) <= {"backend", "compiled", "effects", "errors", "protocols", "spec", "trace"}, (
            path
        )


def other_backends(name: str) -> set[str]:
    """Return the packages of other backends that one imports."""
    found = set()
    for path in (PACKAGE.parent / "backends" / name).rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module] if isinstance(node, ast.ImportFrom) and node.module else []
            found |= {name.split(".")[0] for name in names}
    return {other for other in found if other.startswith("s2r_")} - {name, "s2r_spec"}


def test_the_robot_may_import_its_simulator_and_no_backend_another():
    names = {path.name for path in (PACKAGE.parent / "backends").iterdir() if path.name.startswith("s2r_")}
    allowed = {
        "s2r_a1": {"s2r_sim"},
        "s2r_sim": {"s2r_mujoco"},
        "s2r_gym": {"s2r_policy"},
        "s2r_mujoco": {"s2r_policy"},
    }
    for name in names:
        assert other_backends(name) <= allowed.get(name, set()), name


def printed(code: str) -> set[str]:
    """Return the words that a fresh interpreter prints."""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(done.stdout.split())


HEAVY = {
    "numpy",
    "torch",
    "gpytorch",
    "mujoco",
    "pinocchio",
    "piqp",
    "numba",
    "matplotlib",
    "scipy",
    "pint",
    "lark",
}


@pytest.mark.parametrize("statement", ["import s2r_spec", "import s2r_spec.cli"])
def test_a_light_import_brings_nothing_heavy(statement):
    code = f"{statement}; import sys; print(' '.join(sys.modules))"
    assert not HEAVY & printed(code)


def loaded(lines: list[list[str]], codes: set[int] | None = None) -> dict[str, list[str]]:
    """Return what each of these command lines has loaded, run one after the other by a fresh interpreter.

    They end with one of the exit ``codes``, if any are given.
    """
    code = f"""
import contextlib, io, json, sys
from s2r_spec.cli import main
found, codes = {{}}, []
for words in {lines}:
    sys.argv, code = ["s2r", *words], 0
    with contextlib.redirect_stdout(io.StringIO()):
        try:
            main()
        except SystemExit as end:
            code = end.code or 0
    codes.append(code)
    found[" ".join(words)] = sorted(sys.modules)
print(json.dumps([found, codes]))
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    found, ended = json.loads(done.stdout)
    assert codes is None or {*ended} <= codes, done.stderr
    return found


def test_no_help_loads_a_library_of_numbers_or_of_pictures():
    every = loaded([["--help"], *([name, "--help"] for name in EXAMPLES)])
    assert len(every) > 15
    for words, modules in every.items():
        assert not HEAVY & {*modules}, words
        # Each of these takes as long as typer itself, in its other layout of a help or for the value of a flag.
        assert not {"pydantic", "rich.console", "rich.markdown"} & {*modules}, words


def test_a_command_of_small_work_loads_little(tmp_path):
    """Commands whose result needs a Gaussian process find out first whether their files exist."""
    spec, trace = "specs/a1_velocity.stl", "specs/traces/a1_velocity_fails.csv"
    whole = [
        ["monitor", spec, trace], ["fmt", "--check", spec], ["lint", spec], ["log", trace], ["docs"], ["--version"],
        ["examples", str(tmp_path / "examples")], ["backends"], ["backends", "turtlebot"], ["backends", "sim"],
    ]  # fmt: skip
    missing = [
        ["check", "none.stl", "--backend", "sim"], ["plan", "none.stl", "--backend", "sim"],
        ["gap", "none.stl", "--sim", "sim", "--real", "log:none"], ["report", "none"], ["replay", "none#1"],
        ["certify", "none.stl", "--sim", "sim", "--real", "log:none"], ["odds", "none", "--B", "1", "--below", "0"],
        ["diagnose", "none.stl", "--sim", "sim", "--real", "log:none"], ["choose", "none", "none"],
    ]  # fmt: skip
    for words, modules in loaded([*whole, *missing]).items():
        assert not {"torch", "gpytorch", "linear_operator", "matplotlib", "mujoco", "numba"} & {*modules}, (
            words
        )


@pytest.mark.parametrize("name", ["monitor", "log", "report", "replay", "plan", "check"])
def test_a_command_loads_no_torch(name, tmp_path, toy):
    """Each on a small input, and in a process of its own."""
    spec, trace, run = "specs/a1_velocity.stl", "specs/traces/a1_velocity_fails.csv", tmp_path / "run"
    words = {
        "monitor": [spec, trace],
        "log": [trace],
        "report": [str(run)],
        "replay": [f"{run}#0.0"],
        "plan": ["--R", "0.1", "--eps", "0.1", "--delta", "0.1", "--B", "0.3"],
        "check": [str(tmp_path / "small.stl"), "--backend", "toy", "--budget", "16", "--run", str(run)],
    }[name]
    (tmp_path / "small.stl").write_text(SMALL)
    if name in ("report", "replay"):
        requirement = s2r.parse_spec(SMALL, str(tmp_path / "small.stl"))
        s2r.check(requirement, "toy", run, budget=16, executor=lambda: ThreadPoolExecutor(1))
    (modules,) = loaded([[name, *words]], {0, 1, 3}).values()
    assert not {"torch", "gpytorch", "linear_operator"} & {*modules}
    assert name != "monitor" or not {"pint", "matplotlib", "scipy"} & {*modules}


SMALL = """\
signal vx {m/s}
param  vd {m/s} in [-0.2, 0.3]
require walking: always[0.5 s, 1.5 s] (abs(vx - vd) <= 0.1 {m/s})
certify walking: delta = 1e-3, epsilon = 0.1, B = 0.5, R = 0.02, kernel = rbf(0.2 {m/s}), fall = -0.5
"""


def test_workers_and_the_language_need_neither_torch_nor_a_simulator():
    names = [
        "s2r_spec.lang",
        "s2r_spec.robustness",
        "s2r_spec.runs.runner",
        "s2r_spec.spec",
        "s2r_spec.logs",
    ]
    code = f"import sys, {', '.join(names)}; print(' '.join(sys.modules))"
    assert not {"torch", "mujoco", "pinocchio", "numba"} & printed(code)


def test_every_public_name_is_found_where_it_is_said_to_be():
    assert sorted(s2r._HOME) == sorted(s2r.__all__)
    for name in s2r.__all__:
        assert getattr(s2r, name) is not None
    with pytest.raises(AttributeError, match="'chekc'"):
        s2r.chekc  # noqa: B018


def test_a_worker_loads_next_to_nothing_before_its_backend():
    code = "import s2r_spec.workers.worker, sys; print(' '.join(sys.modules))"
    assert not {"numpy", "rich", "s2r_spec.spec"} & printed(code)


def wide(path: Path) -> set[str]:
    """Return the functions of a file that have more than seven parameters; ``self`` does not count."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.FunctionDef):
            parameters = (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)
            if len({one.arg for one in parameters} - {"self", "cls"}) > 7:
                found.add(node.name)
    return found


COMMANDS = {f"s2r_spec/cli/{name}.py": {name} for name in EXAMPLES} | {
    "s2r_spec/cli/options/against.py": {"command"}
}
"""File → its function whose parameters are the arguments and options of a command."""
WIDE = {
    "s2r_spec/spec/evaluated.py": {"robustness", "evaluate"},
    "s2r_spec/diagnose/run.py": {"diagnose"},
}
"""File → functions that may have more parameters: users see each keyword of them with its default."""


def test_a_function_has_at_most_seven_parameters():
    files = [*PACKAGE.rglob("*.py"), *SIMULATOR.parent.rglob("*.py")]
    found = {place(path): names for path in files if (names := wide(path) - COMMANDS.get(place(path), set()))}
    assert found == WIDE


def test_a_function_of_the_commands_is_short():
    """A command is its options, one call and what it prints."""
    for path in (PACKAGE / "cli").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.FunctionDef):
                assert node.end_lineno - node.lineno < 60, f"{place(path)}: {node.name}"
