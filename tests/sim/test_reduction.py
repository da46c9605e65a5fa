"""The compiled linear algebra of one tick against NumPy's."""

import numpy as np
import pytest

from s2r_sim.controller.reduction import (
    base_acceleration,
    distribute,
    force_cost,
    in_joint_space,
    laws_of_motion,
    solve,
)


@pytest.mark.parametrize("n", [1, 3, 6])
def test_elimination_solves(n):
    rng = np.random.default_rng(n)
    A, X = rng.normal(size=(n, n)), rng.normal(size=(n, 4))
    A[0, 0] = 0.0 if n > 1 else 2.0  # without row pivots this would divide by zero
    B = A @ X
    solve(A.copy(), B)
    np.testing.assert_allclose(B, X, atol=1e-12)


def random_tick(loaded):
    """Return a mass matrix, bias, foot Jacobian, foot task, known part and base task, all made up."""
    rng = np.random.default_rng(0)
    own = np.kron(np.eye(4), np.ones((3, 3)))
    M = rng.normal(size=(18, 18))
    M = M @ M.T
    M[6:, 6:] *= own
    jacobian = np.hstack([rng.normal(size=(12, 6)), own * rng.normal(size=(12, 12))])
    return (
        M + 30.0 * np.eye(18),
        rng.normal(size=18),
        jacobian,
        rng.normal(size=(3, 12)),
        rng.normal(size=(3, 12)),
        rng.normal(size=(6, 7)),
        np.array(loaded),
        rng.normal(size=(len(loaded) + 1, len(loaded) + 1)),
    )


@pytest.mark.parametrize("loaded", [range(3), [0, 1, 2, 9, 10, 11], range(12)])
def test_forces_explain_all_of_the_motion(loaded):
    mass, bias, jacobian, feet, known, base, loaded, share = random_tick(loaded)
    n = len(loaded)
    law, acceleration, cost = np.empty((18, 7)), np.empty((7, n + 1)), np.empty((n + 1, n + 1))
    q, legs = np.arange(12.0), np.empty((12, 7))
    angles, speeds = in_joint_space(jacobian, feet, known, q, 1e3, legs)
    upper = np.asfortranarray(np.triu(mass))  # by columns, as Pinocchio has it: for this a tick is compiled
    laws_of_motion(upper, bias, legs, law)
    base_acceleration(law, jacobian, loaded, acceleration)
    force_cost(base, acceleration, share, cost)
    f = np.random.default_rng(1).normal(size=n)
    everything = distribute(law, acceleration, jacobian, loaded, f)
    forces, torque, a = everything[:12], everything[12:24], everything[24:]

    assert forces[loaded].tolist() == f.tolist()
    assert not np.delete(forces, loaded).any()
    joints = legs[:, :6] @ a + legs[:, 6]
    np.testing.assert_allclose(jacobian @ [*a, *joints], feet[0] - known[0], atol=1e-9)
    steps = np.array([angles - q, speeds])
    np.testing.assert_allclose(steps @ jacobian[:, 6:].T, feet[1:] - known[1:], atol=1e-9)
    near, _ = in_joint_space(jacobian, feet, known, q, 0.1, legs)
    np.testing.assert_allclose(near, q + np.clip(angles - q, -0.1, 0.1), atol=1e-12)
    forced = np.concatenate([np.zeros(6), torque]) + jacobian.T @ forces
    np.testing.assert_allclose(mass @ [*a, *joints] + bias, forced, atol=1e-7)
    deviation = base @ [*a, 1.0]
    with_one = np.array([*f, 1.0])
    expected = deviation @ deviation + with_one @ share @ with_one
    assert with_one @ cost @ with_one == pytest.approx(expected, rel=1e-9)


def test_a_diverged_state_and_a_stretched_leg_raise_nothing():
    _, _, jacobian, feet, known, *_ = random_tick(range(12))
    q, legs = np.zeros(12), np.empty((12, 7))
    targets = in_joint_space(jacobian * np.nan, feet, known, q, 0.3, legs)
    assert np.isnan(legs).all()
    assert np.isnan(targets).all()
    jacobian[:3, 6:9] = 0.0
    in_joint_space(jacobian, feet, known, q, 0.3, legs)
    assert not np.isfinite(legs[:3]).any()
