"""Residuals of a recorded motion for a robot in a world: inverse dynamics, motors, sensors, feet.

Data: a recorded motion with forces and torques. The laws of motion (Pinocchio's
recursive Newton–Euler algorithm; Featherstone, *Rigid Body Dynamics Algorithms*,
2008, §5.3) give the forces that the motion between two samples requires. A residual
is the required force minus the recorded one:

    base wrench    Mq̈ + h − Σ Jᵀf − push            on the base's six rows
    joint torque   Mq̈ + h − Jᵀf − τ + friction      on the joints' twelve

A weak motor, friction in a gear, a payload, a push: each appears in the rows on
which it acts, under any reaction of the controller. It disappears when the model of
the world contains it.

Recorded joints and attitude come from the robot's own sensors. The true motion is the
one that sensors with the world's errors would report as recorded. Accelerations are
differences of recorded velocities. All residuals are averaged over :data:`WINDOW` with
Hann weights, which keep the gait (2.5 Hz) and remove noise. This code has no influence on a
trace, and is not part of the model's hash.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.ndimage import convolve1d

from s2r_sim.controller.gains import Gains
from s2r_sim.effects import with_effects
from s2r_sim.parameters import Test, read_test
from s2r_sim.plant.channels import FEET, JOINTS
from s2r_sim.plant.physics import Physics
from s2r_sim.protocols import PROTOCOLS
from s2r_sim.residuals.motion import RecordedMotion, hann, recorded_motion
from s2r_sim.residuals.world import ModelledMotion, Protocol
from s2r_sim.robot.constants import FloatArray
from s2r_sim.settings import Settings
from s2r_spec.effects import Choice
from s2r_spec.errors import TraceError, one_of
from s2r_spec.protocols import PROTOCOL, named
from s2r_spec.trace import Trace

WINDOW = 0.03
"""[s] width of the Hann weights over differences."""

_POSE = ("x", "y", "z", "roll", "pitch", "yaw")
_MOTION = (*_POSE, "vx", "vy", "vz", "omega", "q", "dq")
_BASE = ("base",) * 3


@dataclass(frozen=True)
class _Residual:
    """One residual.

    Attributes:
        name: name of its channel.
        unit: unit of its channel.
        needs: channels that the trace must have. Some more improve the residual. ``foot_force`` gives the sinkage
            and creep of feet, and ``foot_velocity`` their sliding. ``roll`` and ``pitch`` give the tilt of a misaligned
            IMU, and ``tau`` the position of rotors in the play of their gears.
        knows: fields of the world that change the residual; all other fields are at their defaults.
        parts: the part of the robot of each column.
        of: function from a motion in a world to (n − 1, columns).
        by_gains: whether it depends on the gains of the joints, which follow from a test's stance or from a protocol.
    """

    name: str
    unit: str
    needs: tuple[str, ...]
    knows: tuple[str, ...]
    parts: tuple[str, ...]
    of: Callable[[ModelledMotion], FloatArray]
    by_gains: bool = False

    def possible(self, trace: Trace) -> bool:
        """Whether the trace has all that is needed."""
        channels = {*trace.channels, *(("stance",) if self.by_gains and PROTOCOL in trace.meta else ())}
        return channels.issuperset(self.needs)


def residuals(
    trace: Trace, settings: Settings, effects: Choice = (), params: Mapping[str, float] | None = None
) -> Trace:
    """Return the residuals; see :meth:`s2r_spec.backend.HasResiduals.residuals`.

    The world has the physics of ``settings.physics`` with the test's slope, payload and push, and with those
    of these effects that predict the record.
    """
    # A protocol has the plain world: its parameters are those of its references.
    test = read_test({} if PROTOCOL in trace.meta else params or {})
    protocol = _protocol(trace, params or {})
    possible = [one for one in RESIDUALS if one.possible(trace)]
    if not possible:
        raise TraceError(
            f"no residual can be computed from the channels {one_of(trace.channels)}; the fewest are needed for "
            f"{_FEWEST.name!r}: {', '.join(_FEWEST.needs)}"
        )
    window = hann(trace.times, WINDOW)
    if len(trace) < len(window) + 1:
        raise TraceError(
            f"residuals need {len(window) + 1} samples or more, and the trace has {len(trace)}; "
            f"they are averaged over {WINDOW:g} s"
        )
    log = recorded_motion(trace, settings.robot)
    bare, here = test.world(settings.physics), test.world(with_effects(settings.physics, effects))
    channels = {}
    for one in possible:
        worlds = _with_fields(bare, one.knows), _with_fields(here, one.knows)
        channels[one.name] = _averages(one, log, settings.gains, *worlds, (test, protocol))
    units = {one.name: one.unit for one in possible}
    parts = {one.name: one.parts for one in possible}
    return Trace(_inner(trace.times[:-1] + log.dt / 2, window), channels, units, {"parts": parts})


def _protocol(trace: Trace, params: Mapping[str, float]) -> Protocol | None:
    if PROTOCOL not in trace.meta:
        return None
    one = named(PROTOCOLS, str(trace.meta[PROTOCOL]), "sim")
    return one.name, tuple(one.values(params).items())


_modelled_motion = lru_cache(maxsize=4)(ModelledMotion)


@lru_cache(maxsize=128)
def _averages(
    one: _Residual,
    log: RecordedMotion,
    gains: Gains,
    bare: Physics,
    here: Physics,
    way: tuple[Test, Protocol | None],
) -> FloatArray:
    """Return the (m, columns) averages of a residual; cached, for most worlds change only one or two residuals."""
    window = hann(log.trace.times, WINDOW)
    return _inner(convolve1d(one.of(_modelled_motion(log, gains, bare, here, *way)), window, axis=0), window)


def _inner(values: FloatArray, window: FloatArray) -> FloatArray:
    """Return the rows with a whole window around them."""
    half = len(window) // 2
    return values[half : len(values) - half]


def _with_fields(world: Physics, fields: tuple[str, ...]) -> Physics:
    """Return a world with these fields of another one, and defaults for the rest."""
    return Physics(**{name: getattr(world, name) for name in fields})


def _base_wrench(motion: ModelledMotion) -> FloatArray:
    ground, _ = motion.forces
    left: FloatArray = motion.needed[:, :6] - ground
    left[:, :3] -= motion.push
    return left


def _acceleration(motion: ModelledMotion) -> FloatArray:
    """Acceleration expected from the QP's prediction minus the recorded one; forward, left, up."""
    log = motion.recorded
    return motion.follows - _ahead(log, log.rate(log.velocity))


def _estimate(motion: ModelledMotion) -> FloatArray:
    own = np.column_stack([motion.recorded.at(f"{name}_est") for name in ("vx", "vy")])
    return own - motion.estimated


def _slip(motion: ModelledMotion) -> FloatArray:
    x, y, _ = np.moveaxis(_ahead(motion.recorded, motion.slides), -1, 0)
    touches = motion.recorded.touches
    return np.hstack((touches * x, touches * y))


def _unevenness(motion: ModelledMotion) -> FloatArray:
    """Distance of footholds from the plane through all of them, minus the distance expected from the roughness."""
    footing = motion.recorded.footing
    away = np.abs(footing.about @ footing.mean(motion.below))
    return footing.spread(away - motion.world.roughness * footing.expected)


def _foot_place(motion: ModelledMotion) -> FloatArray:
    log = motion.moved
    place, _, _ = log.feet
    base = np.column_stack([log.mid(name) for name in ("x", "y", "z")])
    turned = np.einsum("nij,nkj->nki", log.attitude, place) + base[:, None]
    return log.mid("foot_position") - turned.reshape(-1, 12)


def _ahead(log: RecordedMotion, vector: FloatArray) -> FloatArray:
    """Return (n − 1, …, 3) vectors, given in world axes, as forward, left and up."""
    x, y, z = np.moveaxis(vector, -1, 0)
    yaw = log.mid("yaw").reshape(-1, *[1] * (vector.ndim - 2))
    c, s = np.cos(yaw), np.sin(yaw)
    return np.stack((c * x + s * y, c * y - s * x, z), axis=-1)


_WITH_FORCE = (*_MOTION, "foot_force")
_ON_GROUND = (*_MOTION, "contact")
_EACH_AXIS = tuple(f"{foot} foot" for foot in FEET for _ in range(3))
_EACH_FOOT = tuple(f"{foot} foot" for foot in FEET)

_SENSES = ("encoder_offset", "attitude_bias", "backlash", "armature", "torque_constant", "timestep")
_JOINTS_KNOW = ("damping", "dry_friction", "drag", "drag_height", "slope", *_SENSES)
_BASE_KNOWS = ("payloads", "com_shift", "drag", "drag_height", "slope", *_SENSES)
_MOTORS_KNOW = ("strength", "fade", "fade_by_load", "voltage", "latency", "timestep")
_QP_KNOWS = ("strength", "fade", "fade_by_load", "torque_constant", "payloads", "com_shift", "attitude_bias")
_ESTIMATE_KNOWS = ("velocity_bias", "velocity_scale", "attitude_bias")
_SLIP_KNOWS = ("impratio", "sink", "slope", *_SENSES)
_GROUND_KNOWS = ("sink", "impratio", "slope")
_IMU_AND_LEGS = ("IMU and legs",) * 2
_ENCODERS = tuple(f"{name} encoder" for name in JOINTS)

RESIDUALS = (
    _Residual("joint_torque", "N*m", (*_WITH_FORCE, "tau"), _JOINTS_KNOW, JOINTS, lambda motion: motion.joints),
    _Residual("base_force", "N", _WITH_FORCE, _BASE_KNOWS, _BASE, lambda motion: _base_wrench(motion)[:, :3]),
    _Residual("base_torque", "N*m", _WITH_FORCE, _BASE_KNOWS, _BASE, lambda motion: _base_wrench(motion)[:, 3:]),
    _Residual("motor", "N*m", ("q", "dq", "tau", "tau_cmd", "stance"), _MOTORS_KNOW, JOINTS,
              lambda motion: motion.recorded.at("tau") - motion.delivered, True),
    _Residual("acceleration", "m/s^2", ("acc_pred", "vx", "vy", "vz", "yaw"), _QP_KNOWS, _BASE, _acceleration),
    _Residual("velocity_estimate", "m/s", ("vx_est", "vy_est", "vx", "vy"), _ESTIMATE_KNOWS, _IMU_AND_LEGS, _estimate),
    _Residual("slip", "m/s", _ON_GROUND, _SLIP_KNOWS, _EACH_FOOT * 2, _slip),
    _Residual("grip", "N", (*_ON_GROUND, "foot_force"), (*_SLIP_KNOWS, "friction"), _EACH_FOOT,
              lambda motion: motion.grips),
    _Residual("sinking", "m", ("foot_position", "contact"), _GROUND_KNOWS, _EACH_FOOT,
              lambda motion: motion.recorded.touches * motion.below),
    _Residual("unevenness", "m", ("foot_position", "contact"), ("roughness", *_GROUND_KNOWS), _EACH_FOOT, _unevenness),
    _Residual("contact_timing", "", ("contact", "stance"), (), _EACH_FOOT,
              lambda motion: motion.recorded.at("contact") - motion.recorded.at("stance")),
    _Residual("joint_speed", "rad/s", ("q", "dq"), (), _ENCODERS,
              lambda motion: motion.recorded.rate(motion.recorded.trace["q"]) - motion.recorded.mid("dq")),
    _Residual("foot_place", "m", (*_POSE, "q", "foot_position"), _SENSES, _EACH_AXIS, _foot_place),
)  # fmt: skip
"""``motor`` has the joints at the end of the tick; ``sinking`` is the depth of ball feet below the world's ground.
``slip`` has the forward, then the left velocities of the feet that touch. ``contact_timing`` is +1 where a foot
touches in its swing, −1 where it does not touch in its stance."""
_FEWEST = min(RESIDUALS, key=lambda one: len(one.needs))
