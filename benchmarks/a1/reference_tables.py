"""The tables of docs/reference/a1.md, from the code itself.

Run: python -m benchmarks.a1.reference_tables

``tests/sim/test_reference.py`` holds the page to what this prints.
"""

from __future__ import annotations

import numpy as np

from benchmarks import tables
from benchmarks.tables import table
from s2r_sim import SimBackend
from s2r_sim.controller.gains import RATE
from s2r_sim.effects import CATALOGUE
from s2r_sim.plant.channels import CHANNELS, FROM_OUTSIDE, TRUE_CHANNELS
from s2r_sim.plant.noise import Noise
from s2r_sim.plant.physics import Physics
from s2r_sim.residuals import RESIDUALS
from s2r_sim.robot.constants import A1, GRAVITY
from s2r_sim.twins import PLACES
from s2r_spec.trace import Trace


def figures() -> str:
    nominal = Physics()
    return table(
        ("figure", "value"),
        [
            ("mass", f"{A1.mass:.3f} kg, of it trunk {A1.trunk.mass:g} kg"),
            ("hip, thigh, shank with foot", f"{A1.hip.mass:g}, {A1.thigh.mass:g}, {A1.shank.mass:g} kg"),
            ("thigh and calf length", f"{A1.thigh_length:g} and {A1.calf_length:g} m"),
            ("hips at", f"±{A1.hip_x:g}, ±{A1.hip_y:g} m; thigh {A1.thigh_y:g} m further out"),
            ("ball foot", f"radius {A1.foot_radius:g} m"),
            ("torque limit", f"{A1.torque_limit:g} N*m"),
            ("gravity", f"{GRAVITY:g} m/s^2"),
            ("physics step, control rate", f"{nominal.timestep:g} s, {RATE} Hz"),
            ("foot on ground", f"friction {nominal.friction:g}, torsional {nominal.torsion:g} m"),
            (
                "joint",
                f"armature {nominal.armature:g} kg*m^2, damping {nominal.damping:g} N*m*s/rad, "
                f"dry friction {nominal.dry_friction:g} N*m",
            ),
        ],
    )


def noise() -> str:
    n = Noise()
    return table(
        ("what", "standard deviation"),
        [
            ("joint angle", f"{n.encoder:g} rad"),
            ("joint speed", f"{n.joint_speed:g} rad/s"),
            ("gyroscope", f"{n.gyro:g} rad/s"),
            ("roll, pitch, yaw", f"{n.attitude:g} rad"),
            ("fed-back base velocity", f"{n.velocity:g} m/s (not with feedback=estimate)"),
            ("accelerometer, mean over a tick", f"{n.accelerometer:g} m/s^2"),
            ("initial height", f"{n.initial_height:g} m"),
            ("initial attitude", f"{n.initial_attitude:g} rad"),
            ("initial joint angle", f"{n.initial_joint:g} rad"),
            ("gait phase at the command", f"uniform over {n.gait_phase:.0%} of the period"),
        ],
    )


def parameters() -> str:
    return tables.parameters(SimBackend())


def channels() -> str:
    return table(
        ("channel", "unit", "width", "by", ""),
        [
            (f"`{c.name}`", c.unit, c.width, "outside" if c.name in FROM_OUTSIDE else "robot", c.description)
            for c in CHANNELS
        ]
        + [(f"`{c.name}`", c.unit, c.width, "outside*", c.description) for c in TRUE_CHANNELS],
    )


def effects() -> str:
    return tables.effects(SimBackend())


def twins() -> str:
    return table(
        ("twin", "effects"),
        [
            (
                f"`twin:{place}`",
                ", ".join(f"`{e}.{p}={v:g}`" for e, values in mixture.items() for p, v in values.items()),
            )
            for place, mixture in PLACES.items()
        ],
    )


def residuals() -> str:
    """Each residual with the effects of which the simulator that has them leaves less than half in it.

    Of one rollout with a parameter at one of four values, beyond what a nominal rollout leaves.
    """
    sim = SimBackend(duration=0.5)

    def sizes(of: SimBackend, trace: Trace) -> dict[str, float]:
        found = of.residuals(trace, {"vd": 0.3})
        return {name: float(np.abs(values).mean()) for name, values in found.channels.items()}

    usual = sizes(sim, sim.rollout({"vd": 0.3}, seed=0))
    known: dict[str, list[str]] = {one.name: [] for one in RESIDUALS}
    for effect in CATALOGUE.values():
        machines = [
            sim.with_effects({effect.name: {p.name: (1.0 - part) * p.nominal + part * end}})
            for p in effect.parameters
            for end in (p.low, p.high)
            for part in (0.3, 1.0)
        ]
        traces = [machine.rollout({"vd": 0.3}, seed=0) for machine in machines]
        asked = [
            (sizes(sim, trace), sizes(machine, trace))
            for machine, trace in zip(machines, traces, strict=True)
            if trace.failure is None
        ]
        for name, effects in known.items():
            if any(
                bare[name] > 2.0 * usual[name]
                and knowing[name] - usual[name] < 0.5 * (bare[name] - usual[name])
                for bare, knowing in asked
            ):
                effects.append(f"`{effect.name}`")
    return table(
        ("residual", "unit", "columns", "effects that it knows"),
        [(f"`{one.name}`", one.unit, len(one.parts), ", ".join(known[one.name])) for one in RESIDUALS],
    )


TABLES = (figures, noise, parameters, channels, effects, residuals, twins)

if __name__ == "__main__":
    print("\n\n".join(make() for make in TABLES))
