"""The optimum of the QP against a second solver's, on problems recorded in closed loop."""

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
    """Return (problem, optimum, whether PIQP was asked) of the last ticks of one rollout."""
    seen = []
    solve, solve_condensed = Solver.solve, StanceQP.solve

    def record(self, fixed, **problem):
        found = solve(self, fixed, **problem)
        seen.append((copies(fixed | problem), found[0].copy(), True))
        return found

    def record_condensed(self, body, task):
        solution = solve_condensed(self, body, task)
        problem = self._problems[task.stance]
        whole = problem.bounds | problem.rows(body)
        seen.append((copies(whole), solution.forces[problem.loaded], bool(solution.iterations)))
        return solution

    if settings.form == "full":
        monkeypatch.setattr(Solver, "solve", record)
    else:
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
    """Return (ticks,) differences in force [N]; how often friction, torque, any limit bound, and PIQP was asked."""
    errors, friction, torque, limited, asked = [], 0, 0, 0, 0
    for problem, ours, by_piqp in recorded(settings, monkeypatch):
        theirs = reference(problem)
        errors.append(np.abs(ours - theirs)[18 if settings.form == "full" else 0 :].max())
        rows = problem["G"] @ theirs
        at_bound = np.minimum(problem["h_u"] - rows, rows - problem["h_l"]) < 1e-5
        friction += (at_bound & (problem["h_u"] == 0.0))[:-12].any()
        torque += at_bound[-12:].any()
        limited += at_bound.any()
        asked += by_piqp
    return np.array(errors), friction, torque, limited, asked


@pytest.mark.parametrize("form", ["condensed", "full"])
def test_a_second_solver_finds_the_same_forces(form, monkeypatch):
    errors, *_ = force_errors(replace(EASY, form=form), monkeypatch)
    assert errors.max() < 0.01


@pytest.mark.parametrize("form", ["condensed", "full"])
def test_it_does_where_friction_and_torque_bind(form, monkeypatch):
    errors, friction, torque, limited, asked = force_errors(replace(HARD, form=form), monkeypatch)
    assert friction > 20
    assert torque > 20
    assert asked >= limited
    # 0.1 % of the load of a foot; the internal force between two feet is nearly free.
    assert errors.max() < 0.07
    assert np.median(errors) < 0.01


def test_piqp_is_left_out_where_no_limit_matters(monkeypatch):
    errors, _, _, limited, asked = force_errors(EASY, monkeypatch)
    assert limited == asked == 0
    assert errors.max() < 1e-4
