"""What stands between a motor command and the joint: limits, delay, play; and the shape of the ground."""

import mujoco
import numpy as np
import pytest

from s2r_sim.plant import terrain
from s2r_sim.plant.physics import Physics
from s2r_sim.plant.plant import Plant
from s2r_sim.robot.constants import A1
from s2r_sim.robot.signals import MotorCommand

NONE = np.zeros(12)


def hanging(**physics):
    """Return a plant far above the ground."""
    plant = Plant(A1, Physics(**physics))
    plant.place(np.array([0.0, 0.0, 5.0]), np.zeros(3), np.tile([0.0, 0.9, -1.8], 4))
    return plant


def delivered(plant, motors):
    plant._motors.act(motors, 0.0)
    mujoco.mj_forward(plant.model, plant.data)
    return plant.data.actuator_force.copy()


def constant(torque):
    return MotorCommand(NONE, NONE, NONE, NONE, np.full(12, torque))


def test_the_motor_law_is_feedforward_plus_springs_and_dampers():
    plant = hanging()
    rng = np.random.default_rng(0)
    q, dq, kp, kd, tau = rng.uniform(0.1, 2.0, (5, 12))
    motors = MotorCommand(q=q, dq=dq, kp=kp, kd=kd, tau=tau)
    truth = plant.truth()
    np.testing.assert_allclose(
        delivered(plant, motors), tau + kp * (q - truth.q) + kd * (dq - truth.dq), atol=1e-12
    )


def test_torque_is_clipped():
    assert delivered(hanging(), constant(50.0)) == pytest.approx(33.5)


def test_strength_scales_torque_and_limit():
    assert delivered(hanging(strength=0.8), constant(10.0)) == pytest.approx(8.0)
    assert delivered(hanging(strength=0.8), constant(50.0)) == pytest.approx(0.8 * 33.5)


def test_strength_fades_with_time_and_not_below_nothing():
    plant = hanging(fade=0.2)
    for elapsed, left in ((-1.0, 1.0), (1.0, 0.8), (10.0, 0.0)):
        plant._motors.act(constant(10.0), elapsed)
        mujoco.mj_forward(plant.model, plant.data)
        assert plant.data.actuator_force == pytest.approx(10.0 * left)


@pytest.mark.parametrize(("part", "idle", "usual"), [(0.0, 0.9, 0.9), (0.5, 0.95, 0.9), (1.0, 1.0, 0.9)])
def test_strength_that_fades_with_the_load_stays_in_idle_motors(part, idle, usual):
    """Twelve torques of 4.54 N m are the usual load."""
    for torque, left in ((1e-6, idle), (4.54, usual)):
        plant = hanging(fade=0.1, fade_by_load=part)
        for elapsed in np.linspace(0.0, 1.0, 101):
            plant._motors.act(constant(torque), elapsed)
            mujoco.mj_forward(plant.model, plant.data)
        assert plant.data.actuator_force / torque == pytest.approx(left, abs=0.012)


def test_latency_delays_by_whole_steps():
    plant = hanging(latency=0.003)
    seen = [delivered(plant, constant(float(k)))[0] for k in range(6)]
    assert seen == [0.0, 0.0, 0.0, 0.0, 1.0, 2.0]


@pytest.mark.parametrize(("speed", "limit"), [(0.0, 33.5), (8.4, 33.5 * 0.2), (12.0, 0.0), (-12.0, 33.5)])
def test_at_low_voltage_only_driving_torque_is_limited(speed, limit):
    plant = hanging(voltage=0.5)
    plant.data.qvel[6:] = speed
    assert delivered(plant, constant(40.0)) == pytest.approx(limit)


def test_a_rotor_in_its_gap_pushes_nothing_and_then_everything():
    plant = hanging(backlash=0.01)
    through = [delivered(plant, constant(2.0))[0] for _ in range(20)]
    crossing = through.index(2.0)
    # From the middle to the flank: a gap of 0.01 rad at 2 N m on 0.005 kg m² takes √(2·0.01/400) s.
    assert crossing == pytest.approx(1000 * np.sqrt(2 * 0.01 * 0.005 / 2.0), abs=2)
    assert through[:crossing] == [0.0] * crossing
    assert through[crossing:] == [2.0] * (20 - crossing)
    assert plant.play[0] == pytest.approx(0.01)


def test_an_encoder_offset_moves_the_motor_s_spring():
    plant = hanging(encoder_offset=(0.0, 0.05, 0.0))
    truth = plant.truth()
    hold = MotorCommand(q=truth.q, dq=NONE, kp=np.full(12, 20.0), kd=NONE, tau=NONE)
    assert delivered(plant, hold) == pytest.approx(np.tile([0.0, -1.0, 0.0], 4))


def test_slopes_of_the_terrain_are_its_derivatives():
    physics, h = Physics(roughness=0.01, slope=3.0), 1e-6
    for x, y in ((0.1, 0.2), (-3.0, 1.7)):
        _, slope_x, slope_y = terrain.surface(physics, x, y, 1.0, (5.0, 6.0))
        up_x, up_y = (
            (
                terrain.surface(physics, x + dx, y + dy, 1.0, (5.0, 6.0))[0]
                - terrain.surface(physics, x - dx, y - dy, 1.0, (5.0, 6.0))[0]
            )
            / (2 * h)
            for dx, dy in ((h, 0.0), (0.0, h))
        )
        assert (slope_x, slope_y) == (pytest.approx(up_x, abs=1e-6), pytest.approx(up_y, abs=1e-6))


def test_the_terrain_is_as_rough_as_it_says():
    places = np.random.default_rng(0).uniform(-100, 100, (4000, 2))
    heights = [terrain.surface(Physics(roughness=0.01), x, y, 1.0, (0.0, 0.0))[0] for x, y in places]
    assert np.mean(heights) == pytest.approx(0.0, abs=1e-3)
    assert np.std(heights) == pytest.approx(0.01, rel=0.05)


def test_a_plane_s_attitude_turns_z_into_its_normal():
    quat, normal = np.array(terrain.plane_attitude(0.3, -0.2)), np.empty(3)
    mujoco.mju_rotVecQuat(normal, np.array([0.0, 0.0, 1.0]), quat)
    np.testing.assert_allclose(normal, np.array([-0.3, 0.2, 1.0]) / np.sqrt(1.13), atol=1e-12)
