"""What compiled functions must keep to, in every backend."""

import importlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from numba.core.dispatcher import Dispatcher

import s2r_emps
import s2r_sim
from s2r_spec.compiled import say
from s2r_spec.workers.worker_process import WorkerProcess


@pytest.mark.parametrize(("backend", "least"), [(s2r_emps, 0), (s2r_sim, 5)], ids=["emps", "sim"])
def test_compiled_functions_call_those_of_their_own_file_alone(backend, least):
    """Numba would not notice a change in another file, and go on with old machine code."""
    compiled, calls = 0, []
    package = Path(backend.__path__[0])
    for path in package.rglob("*.py"):
        if "@compiled" in path.read_text():
            module = importlib.import_module(".".join(path.relative_to(package.parent).with_suffix("").parts))
            everything = {k: v for k, v in vars(module).items() if isinstance(v, Dispatcher)}
            compiled += len(everything)
            for caller in everything.values():
                called = set(caller.py_func.__code__.co_names) & everything.keys()
                calls += [(caller.__module__, everything[name].__module__) for name in called]
    assert compiled >= 3
    assert len(calls) >= least
    assert all(caller == callee for caller, callee in calls)


MODULE = """\
from s2r_spec.compiled import compiled

@compiled
def double(x):
    return 2.0 * x

print(double(3.0))
"""


def compilations(folder: Path, cache: Path) -> list[bool]:
    """Return whether each of two processes announced that it compiles, where the user's cache is a folder."""
    (folder / "module.py").write_text(MODULE)
    surroundings = os.environ | {"XDG_CACHE_HOME": str(cache), "HOME": str(cache), "NUMBA_CACHE_DIR": ""}
    surroundings["PYTHONPATH"] = os.pathsep.join(filter(None, sys.path))
    said = []
    for _ in range(2):
        done = subprocess.run(
            [sys.executable, "module.py"],
            cwd=folder,
            env=surroundings,
            capture_output=True,
            text=True,
            check=True,
        )
        assert done.stdout == "6.0\n"
        assert done.stderr.count("compiling") <= 1
        said.append("compiling" in done.stderr)
    return said


def test_what_several_workers_announce_is_printed_once(capfd):
    workers = [WorkerProcess("run") for _ in range(2)]
    for worker in workers:
        worker.call(say, "note: compiling something")
        worker.close()
    assert capfd.readouterr().err.count("compiling something") == 1


@pytest.mark.skipif(sys.platform != "linux", reason="the user's cache is elsewhere")
def test_a_second_process_compiles_nothing_even_where_the_installation_cannot_be_written(tmp_path):
    place, cache = tmp_path / "installed", tmp_path / "cache"
    place.mkdir()
    cache.mkdir()
    assert compilations(place, cache) == [True, False]
    assert not list(cache.iterdir())
    shutil.rmtree(place / "__pycache__")
    (place / "__pycache__").touch()  # no folder, for anybody; root may write into one that is read-only
    assert compilations(place, cache) == [True, False]
    assert list(cache.rglob("*.nbi"))
    no_folder = tmp_path / "file"
    no_folder.touch()
    assert compilations(place, no_folder) == [True, True]
