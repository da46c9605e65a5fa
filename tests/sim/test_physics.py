"""The plant obeys mechanics: a thrown robot's momentum and energy, and no force out of nothing."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from s2r_sim.plant.physics import Physics
from s2r_sim.plant.plant import Plant
from s2r_sim.robot.constants import A1, GRAVITY
from s2r_sim.robot.signals import MotorCommand

FREE = Physics(timestep=0.0002, armature=0.0, damping=0.0, dry_friction=0.0)
NONE = np.zeros(12)


def thrown(physics, seed=0):
    """Return a plant that tumbles through the air with moving legs."""
    plant = Plant(A1, physics)
    plant.model.jnt_limited[:] = 0  # the stops of the joints are not elastic
    plant.place(np.array([0.0, 0.0, 50.0]), np.array([0.2, -0.3, 0.5]), np.tile([0.1, 0.9, -1.6], 4))
    rng = np.random.default_rng(seed)
    plant.data.qvel[:] = np.concatenate([[0.5, -0.2, 3.0], rng.normal(size=3), 0.5 * rng.normal(size=12)])
    mujoco.mj_forward(plant.model, plant.data)
    return plant


def balance(plant):
    """Return momentum (3,), angular momentum about the centre of mass (3,), and energy."""
    model, data = plant.model, plant.data
    mujoco.mj_forward(model, data)
    mujoco.mj_subtreeVel(model, data)
    mujoco.mj_energyPos(model, data)
    mujoco.mj_energyVel(model, data)
    return A1.mass * data.subtree_linvel[0], data.subtree_angmom[0].copy(), data.energy.sum()


def fly(plant, ticks, torque):
    """Return the work done by the motors [J] over so many control ticks under constant joint torques [N m]."""
    work, before = 0.0, plant.data.qpos[7:].copy()
    for _ in range(ticks):
        plant.step(MotorCommand(NONE, NONE, NONE, NONE, torque), 0.0)
        work += torque @ (plant.data.qpos[7:] - before)
        before = plant.data.qpos[7:].copy()
    return float(work)


def imbalance(timestep, seed, torque):
    """Return what is out of balance after 0.2 s of flight: momentum, angular momentum, energy."""
    plant = thrown(replace(FREE, timestep=timestep), seed)
    p, L, energy = balance(plant)
    work = fly(plant, 100, torque * np.random.default_rng(seed).normal(size=12))
    p_after, L_after, energy_after = balance(plant)
    return np.array(
        [
            np.linalg.norm(p_after - p - [0.0, 0.0, -A1.mass * GRAVITY * 0.2]),
            np.linalg.norm(L_after - L),
            abs(energy_after - energy - work),
        ]
    )


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("torque", [0.0, 0.3], ids=["limp", "driven"])
def test_a_thrown_robot_keeps_its_momenta_and_balances_energy_with_work(seed, torque):
    coarse, fine = imbalance(0.0002, seed, torque), imbalance(0.0001, seed, torque)
    # What is left over is the integrator's and of first order: it halves with the step,
    # and the limit at no step is no imbalance (of 40 kg m/s, 1 kg m²/s and 60 J).
    assert (np.abs(2.0 * fine - coarse) < 1e-4).all()
    assert coarse[2] < 0.05


def test_the_balance_notices_joint_friction():
    plant = thrown(replace(FREE, damping=0.2))
    _, L, energy = balance(plant)
    work = fly(plant, 100, NONE)
    _, L_after, energy_after = balance(plant)
    # Internal friction takes energy and leaves the angular momentum alone.
    np.testing.assert_allclose(L_after, L, atol=2e-3 * np.linalg.norm(L))
    assert energy_after - energy < work - 0.05


def test_drag_on_feet_takes_energy_and_angular_momentum():
    plant = thrown(replace(FREE, drag=5.0, drag_height=1000.0))
    _, L, energy = balance(plant)
    fly(plant, 100, NONE)
    _, L_after, energy_after = balance(plant)
    assert energy_after < energy - 1.0
    assert np.linalg.norm(L_after - L) > 0.05


def test_payload_and_shifted_mass_are_where_they_should_be():
    plant = Plant(A1, Physics().with_payload(2.0, x=0.1, y=-0.05))
    bare = Plant(A1, Physics())
    inertia, base = plant.model.body("base"), bare.model.body("base")
    assert inertia.mass[0] == pytest.approx(base.mass[0] + 2.0)
    com = (base.mass[0] * base.ipos + 2.0 * np.array([0.1, -0.05, 0.08])) / (base.mass[0] + 2.0)
    np.testing.assert_allclose(inertia.ipos, com, atol=1e-12)
    shifted = Plant(A1, Physics(com_shift=(0.05, 0.0, 0.0))).model.body("base")
    np.testing.assert_allclose(shifted.ipos - base.ipos, [0.05 * 6.0 / 6.001, 0.0, 0.0], atol=1e-12)
