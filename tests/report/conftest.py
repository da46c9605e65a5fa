"""Runs of the toy backend, once for all tests of the reports."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

import s2r_spec as s2r
from s2r_spec.backend import registry
from s2r_spec.certify.real_machine import certify as certify_both
from s2r_spec.report.recompute import Recomputed, recompute
from s2r_spec.runs import task
from s2r_spec.runs.journal import Journal, Record
from s2r_spec.runs.spec_files import SPEC_FILE
from tests.conftest import PLUGIN

SPEC = """\
signal vx {m/s}
param  vd {m/s} in [-0.2, 0.3]
require walking:
    always[0.5 s, 1.5 s] (abs(vx - vd) <= LIMIT {m/s})
certify walking: delta = 1e-3, epsilon = 0.05, B = 0.5, R = DEVIATION, kernel = rbf(0.2 {m/s}), fall = -0.5
"""


@contextmanager
def plugin():
    """Offer the toy's backends in this process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(PLUGIN))
        for cached in (registry._factory, task.open_backend):
            cached.cache_clear()
        yield
    for cached in (registry._factory, task.open_backend):
        cached.cache_clear()


@contextmanager
def undrawn():
    """Paint pictures, but neither lay them out nor write them down: for tests that read a page's words."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "matplotlib.figure.Figure.savefig",
            lambda self, file, **_: file.write('<svg viewBox="0 0 1 1"></svg>'),
        )
        yield


def one_thread() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(1)


def spec_of(limit: float, deviation: float = 0.02, epsilon: float = 0.05) -> s2r.Spec:
    text = (
        SPEC.replace("LIMIT", str(limit)).replace("DEVIATION", str(deviation)).replace("0.05,", f"{epsilon},")
    )
    return s2r.parse_spec(text, "specs/a spec.stl")


@pytest.fixture(scope="session")
def check(tmp_path_factory):
    """Check the toy backend in this process; a report needs no backend any more."""

    def run(limit: float, budget: int | None = None, deviation: float = 0.02, backend_name: str = "toy"):
        folder = tmp_path_factory.mktemp("run") / "walking"
        spec = spec_of(limit, deviation)
        with plugin():
            return spec, s2r.check(spec, backend_name, folder, budget=budget, executor=one_thread)

    return run


@pytest.fixture(scope="session")
def certify(tmp_path_factory):
    """Certify one toy against another in this process."""

    def run(limit: float, budget: int | None = None, deviation: float = 0.02, real: str = "toy:drag"):
        folder = tmp_path_factory.mktemp("run") / "both"
        spec = spec_of(limit, deviation, epsilon=0.1)
        with plugin():
            return spec, certify_both(spec, "toy", real, folder, budget=budget, executor=one_thread), folder

    return run


@pytest.fixture(scope="session")
def promised(certify):
    return certify(0.15)


@pytest.fixture(scope="session")
def unpromised(certify):
    """Few rollouts of a real machine that falls at the end of the test space."""
    return certify(0.06, budget=16, real="toy:fall")


@pytest.fixture(scope="session")
def refused_in_simulation(certify):
    return certify(0.1, deviation=0.001)


@pytest.fixture(scope="session")
def holds(check):
    return check(0.1)


@pytest.fixture(scope="session")
def violated(check):
    return check(-0.05)


@pytest.fixture(scope="session")
def undecided(check):
    return check(0.03, budget=30)


@pytest.fixture(scope="session")
def refused(check):
    """R is a tenth of what the noise really is."""
    found = check(0.1, budget=60, deviation=0.001)
    assert found[1].certificate.label is s2r.Label.REFUSED
    return found


def invented(folder: Path, text: str, budget: int) -> Recomputed:
    """Return a run whose ρ is a bowl plus noise, whatever its parameters mean; no rollout left a trace."""
    from s2r_spec.certify.from_spec import search_for
    from s2r_spec.certify.options import RunOptions

    spec = s2r.parse_spec(text)
    name = spec.requirements[0]
    search = search_for(spec, name, RunOptions(budget=budget))
    header = {
        "s2r": "0", "spec": "invented.stl", "spec_hash": spec.hash, "requirement": name, "backend": "none",
        "model_hash": "0" * 64, "duration": 1.0, "seed": 0, "settings": search.certificate().settings,
    }  # fmt: skip
    journal = Journal.create(folder, header, {SPEC_FILE: spec.text})
    rng = np.random.default_rng(0)
    middle, width = (spec.space.lower + spec.space.upper) / 2, spec.space.upper - spec.space.lower
    while not search.done:
        for query in search.ask():
            share = (spec.space.vector(query.point) - middle) / width
            rho = [0.3 - float(share @ share) + 0.01 * rng.normal() for _ in range(query.replicates)]
            for replicate, value in enumerate(rho):
                failure = "crash: the worker died" if value < 0 else None
                journal.append(
                    Record(query.index, replicate, query.point, 1, value, failure, None, 0.1), None
                )
            search.tell(query, [-value for value in rho])
    return recompute(folder)
