"""The plant's table of assumptions: all physical constants of robot and world."""

from __future__ import annotations

from dataclasses import dataclass, replace

from s2r_sim.robot.constants import Vector3

PAYLOAD_HEIGHT = 0.08
"""[m] height of a payload above the base origin."""
USUAL_LOAD = 247.0
"""[N² m²] sum of the squared torques of all motors in an unhurried trot, the mean of twenty nominal rollouts."""


@dataclass(frozen=True)
class Physics:
    """Physical constants of the simulated world; the controller does not read them.

    The defaults are the nominal plant. Effects are functions from one table to
    another, so that they compose.
    """

    timestep: float = 0.001
    """[s]"""
    iterations: int = 20

    friction: float = 0.8
    """Friction coefficient of foot on ground."""
    torsion: float = 0.01
    """[m] torsional friction of foot on ground."""
    impratio: float = 10.0
    """Stiffness of friction relative to that of the normal force; feet creep where it is small."""
    sink: float = 0.0
    """[m] depth over which the ground builds up its resistance."""
    slope: float = 0.0
    """[deg] slope of the ground, positive uphill along the world's x axis."""
    roughness: float = 0.0
    """[m] standard deviation of the ground's height."""
    drag: float = 0.0
    """[N s/m] drag on every foot within ``drag_height`` [m] of the ground."""
    drag_height: float = 0.06

    armature: float = 0.005
    """[kg m²] armature inertia of every joint."""
    damping: float = 0.05
    """[N m s/rad] damping of every joint."""
    dry_friction: float = 0.1
    """[N m] dry friction of every joint."""
    backlash: float = 0.0
    """[rad] half of the play between every motor and its joint."""

    strength: float = 1.0
    """Torque that the motors deliver, as a fraction of their command."""
    fade: float = 0.0
    """[1/s] fraction of strength lost per second from the command on."""
    fade_by_load: float = 0.0
    """Part of this loss that grows with the squared reported torques instead of time; as fast at :data:`USUAL_LOAD`."""
    voltage: float = 1.0
    """Fraction of the supply voltage that is left; below 1 it limits torque at speed."""
    latency: float = 0.0
    """[s] delay from a command to the motors."""
    torque_constant: float = 1.0
    """True over assumed torque constant; torque reported from the current does not contain this factor."""

    payloads: tuple[tuple[float, Vector3], ...] = ()
    """Point masses on the trunk [kg] with positions [m], base axes; sorted, so that their order has no influence."""
    com_shift: Vector3 = (0.0, 0.0, 0.0)
    """[m] displacement of the trunk's centre of mass, base axes."""

    velocity_bias: tuple[float, float] = (0.0, 0.0)
    """[m/s] forward and left, error of the velocity for the controller."""
    velocity_scale: float = 1.0
    """Factor on that velocity."""
    attitude_bias: tuple[float, float] = (0.0, 0.0)
    """[deg] roll and pitch of the IMU on the trunk."""
    encoder_offset: Vector3 = (0.0, 0.0, 0.0)
    """[rad] encoder errors of hip, thigh and calf, the same on all legs."""

    def with_payload(self, mass: float, x: float = 0.0, y: float = 0.0, z: float = PAYLOAD_HEIGHT) -> Physics:
        """Return the same world with a point mass [kg] on the trunk, at (x, y, z) [m] in base axes."""
        if mass == 0.0:
            return self
        return replace(self, payloads=tuple(sorted((*self.payloads, (mass, (x, y, z))))))


@dataclass(frozen=True)
class FallLimits:
    """Limits of a fall: lowest base height [m], largest tilt of its z axis [rad]."""

    height: float = 0.16
    tilt: float = 0.7
