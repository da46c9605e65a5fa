"""PIQP's optimum against a second solver's, on problems recorded in closed loop."""

from dataclasses import replace

import numpy as np
import pytest

from s2r_sim import SimBackend
from s2r_sim.controller.gains import Gains
from s2r_sim.controller.qp import Solver
from s2r_sim.controller.stance_qp import StanceQP
from s2r_sim.robot.constants import A1
from s2r_sim.settings import Settings

qpsolvers = pytest.importorskip("qpsolvers")
pytestmark = pytest.mark.dev


EASY = Settings()
# A cautious friction pyramid and weak motors, so that constraints of both kinds are active.
HARD = Settings(robot=replace(A1, torque_limit=11.0), gains=Gains(friction=0.12))


def recorded(settings, monkeypatch):
    """Return (problem, optimum, whether torque rows were needed) of the last ticks of one rollout.

    The problem is the whole one, also where the solver was asked without its torque rows.
    """
    seen = []
    solve, solve_condensed = Solver.solve, StanceQP.solve

    def record(self, fixed, **problem):
        found = solve(self, fixed, **problem)
        seen.append((copies(fixed | problem), found[0].copy(), True))
        return found

    def record_condensed(self, body, task):
        solution = solve_condensed(self, body, task)
        problem = self._problems[task.stance]
        rows = problem.with_torque_rows(body, settings.robot.torque_limit)
        whole = problem.bounds | rows | {"P": problem.P, "c": problem.c}
        within = self._solvers[problem.feet][1]
        seen.append((copies(whole), solution.forces[problem.loaded], within in used))
        used.clear()
        return solution

    def note(self, fixed, **problem):
        used.add(self)
        return solve(self, fixed, **problem)

    used = set()
    if settings.form == "full":
        monkeypatch.setattr(Solver, "solve", record)
    else:
        monkeypatch.setattr(Solver, "solve", note)
        monkeypatch.setattr(StanceQP, "solve", record_condensed)
    trace = SimBackend(duration=0.4, settings=settings).rollout({"vd": 0.3}, seed=0)
    assert trace.meta["qp_failures"] == 0
    return seen[-200:]


def copies(problem):
    return {name: np.array(values) for name, values in problem.items()}


def reference(problem):
    """Solve the same problem with DAQP, an active-set method."""
    P, G, lower, upper = (problem[name] for name in ("P", "G", "h_l", "h_u"))
    finite = np.isfinite(lower)
    return qpsolvers.solve_qp(
        P=(P + P.T) / 2,
        q=problem["c"],
        G=np.vstack([G, -G[finite]]),
        h=np.concatenate([upper, -lower[finite]]),
        A=problem.get("A"),
        b=problem.get("b"),
        lb=problem["x_l"],
        ub=problem["x_u"],
        solver="daqp",
    )


def force_errors(settings, monkeypatch):
    """Return (ticks,) differences in force [N]; how often friction and torque bound, and torque rows were used."""
    errors, friction, torque, told = [], 0, 0, 0
    for problem, ours, with_torque_rows in recorded(settings, monkeypatch):
        theirs = reference(problem)
        errors.append(np.abs(ours - theirs)[18 if settings.form == "full" else 0 :].max())
        rows = problem["G"] @ theirs
        at_bound = np.minimum(problem["h_u"] - rows, rows - problem["h_l"]) < 1e-5
        friction += (at_bound & (problem["h_u"] == 0.0))[:-12].any()
        torque += at_bound[-12:].any()
        told += with_torque_rows
    return np.array(errors), friction, torque, told


@pytest.mark.parametrize("form", ["condensed", "full"])
def test_a_second_solver_finds_the_same_forces(form, monkeypatch):
    errors, _, _, _ = force_errors(replace(EASY, form=form), monkeypatch)
    assert errors.max() < 0.01


@pytest.mark.parametrize("form", ["condensed", "full"])
def test_it_does_where_friction_and_torque_bind(form, monkeypatch):
    errors, friction, torque, told = force_errors(replace(HARD, form=form), monkeypatch)
    assert friction > 20
    assert torque > 20
    assert told >= torque
    # 0.1 % of the load of a foot; the internal force between two feet is nearly free.
    assert errors.max() < 0.07
    assert np.median(errors) < 0.01


def test_torque_rows_are_left_out_where_they_do_not_matter(monkeypatch):
    _, _, torque, told = force_errors(EASY, monkeypatch)
    assert torque == told == 0
