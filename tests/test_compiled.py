"""What compiled functions must keep to, in every backend."""

import importlib
from pathlib import Path

import pytest
from numba.core.dispatcher import Dispatcher

import s2r_emps
import s2r_sim


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
