"""Every effect at several magnitudes: the gap it makes, where, and what else it changes in the trace.

Run: OMP_NUM_THREADS=1 python -m benchmarks.a1.effects

The gap is mean ρ(nominal) − mean ρ(with the effect). A signature is how far a
feature of the trace moves, in standard deviations of the nominal simulator
over seeds, at the speed at which it moves most; the three strongest are shown.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from benchmarks.a1.trot import rho
from benchmarks.machine import processor
from s2r_sim import SimBackend
from s2r_sim.controller.gains import RATE
from s2r_sim.effects import CATALOGUE
from s2r_spec.trace import Trace

SPEEDS = (-0.2, 0.0, 0.3)
NOMINAL_SEEDS, SEEDS = 10, 3

MAGNITUDES: dict[str, tuple[Mapping[str, float], ...]] = {
    "motor_strength": ({"factor": 0.9}, {"factor": 0.8}, {"factor": 0.6}),
    "strength_decay": ({"rate": 0.05}, {"rate": 0.1}, {"rate": 0.2}),
    "torque_speed_line": ({"voltage": 0.6}, {"voltage": 0.4}, {"voltage": 0.3}),
    "latency": ({"delay": 0.004}, {"delay": 0.008}, {"delay": 0.016}),
    "dry_friction": ({"torque": 0.3}, {"torque": 0.6}, {"torque": 1.2}),
    "viscous_friction": ({"coefficient": 0.3}, {"coefficient": 0.6}, {"coefficient": 1.2}),
    "armature": ({"inertia": 0.005}, {"inertia": 0.01}, {"inertia": 0.02}),
    "backlash": ({"half_gap": 0.005}, {"half_gap": 0.01}, {"half_gap": 0.02}),
    "ground_friction": ({"factor": 0.5}, {"factor": 0.2}, {"factor": 0.12}),
    "soft_ground": ({"sink": 0.005}, {"sink": 0.015}, {"sink": 0.03}),
    "foot_drag": ({"coefficient": 4.0}, {"coefficient": 8.0}, {"coefficient": 16.0}),
    "shear_creep": ({"stiffness": 0.1}, {"stiffness": 0.03}, {"stiffness": 0.01}),
    "slope": ({"angle": 2.0}, {"angle": 4.0}, {"angle": -4.0}),
    "roughness": ({"height": 0.003}, {"height": 0.006}, {"height": 0.012}),
    "payload": ({"mass": 1.0}, {"mass": 4.0}, {"mass": 2.0, "x": 0.15}),
    "com_offset": ({"x": 0.03}, {"x": -0.06}, {"y": 0.03}),
    "velocity_bias": ({"forward": 0.02}, {"forward": 0.05}, {"forward": 0.1}),
    "velocity_scale": ({"factor": 0.85}, {"factor": 1.15}, {"factor": 1.3}),
    "attitude_bias": ({"pitch": 1.0}, {"pitch": 2.0}, {"pitch": 4.0}),
    "encoder_offset": ({"thigh": 0.02}, {"calf": 0.05}, {"thigh": 0.05}),
    "torque_constant": ({"factor": 0.9}, {"factor": 0.8}, {"factor": 0.7}),
}


def features(trace: Trace) -> dict[str, float]:
    """Return numbers that sum up a trace after 0.5 s."""
    late = slice(RATE // 2, None)
    stands = trace["stance"][late] == 1.0
    ground = (trace["z"] - trace["height"])[late, None]
    foot_z, foot_v = (
        trace["foot_position"][late, 2::3] - ground,
        trace["foot_velocity"][late].reshape(-1, 4, 3),
    )
    sliding = np.hypot(foot_v[:, :, 0], foot_v[:, :, 1])
    forward, up = trace["acc_pred"][:, 0], trace["acc_pred"][:, 2]
    return {
        "vx": trace["vx"][late].mean(),
        "vx ripple": trace["vx"][late].std(),
        "vx_est - vx": (trace["vx_est"] - trace["vx"])[late].mean(),
        "height": trace["height"][late].mean(),
        "roll": trace["roll"][late].mean(),
        "pitch": trace["pitch"][late].mean(),
        "acc_x - pred": (np.gradient(trace["vx"]) * RATE - forward)[late].mean(),
        "acc_z - pred": (np.gradient(trace["vz"]) * RATE - up)[late].mean(),
        "tau": np.abs(trace["tau"][late]).mean(),
        "tau_cmd - tau": np.abs(trace["tau_cmd"] - trace["tau"])[late].mean(),
        "stance slip": sliding[stands].mean(),
        "stance height": foot_z[stands].mean(),
        "swing height": foot_z[~stands].mean(),
        "early contact": trace["contact"][late][~stands].mean(),
    }


def measure(backend: SimBackend, seeds: int) -> tuple[np.ndarray, np.ndarray, int]:
    """Return (speeds, seeds) ρ, (speeds, seeds, features), and the number of falls."""
    found, seen, falls = [], [], 0
    for vd in SPEEDS:
        traces = [backend.rollout({"vd": vd}, seed) for seed in range(seeds)]
        found.append([rho(trace, vd) for trace in traces])
        falls += sum(trace.failure is not None for trace in traces)
        empty = [np.nan] * len(NAMES)
        seen.append([empty if trace.failure else list(features(trace).values()) for trace in traces])
    return np.array(found), np.array(seen), falls


NAMES = list(features(SimBackend(duration=0.6).rollout({}, 0)))


def signature(nominal: np.ndarray, changed: np.ndarray) -> str:
    z = (changed.mean(axis=1) - nominal.mean(axis=1)) / nominal.std(axis=1, ddof=1)
    if np.isnan(z).any():
        return "falls"
    strongest = z[np.abs(z).argmax(axis=0), np.arange(len(NAMES))]
    order = np.argsort(-np.abs(strongest))[:3]
    return ", ".join(f"{NAMES[k]} {strongest[k]:+.0f}" for k in order)


def main() -> None:
    nominal_rho, nominal_features, _ = measure(SimBackend(), NOMINAL_SEEDS)
    print("nominal rho at " + ", ".join(f"{vd:+.1f}" for vd in SPEEDS), nominal_rho.mean(axis=1).round(4))
    print(f"\n{'effect':18} {'values':24} {'-0.2':>7} {'0.0':>7} {'+0.3':>7}  strongest signatures [sigma]")
    assert MAGNITUDES.keys() == CATALOGUE.keys()
    for name, magnitudes in MAGNITUDES.items():
        for values in magnitudes:
            changed = SimBackend().with_effects({name: values})
            found, seen, falls = measure(changed, SEEDS)
            gap = nominal_rho.mean(axis=1) - found.mean(axis=1)
            words = " ".join(f"{key}={value:g}" for key, value in values.items())
            print(
                f"{name:18} {words:24} {gap[0]:7.3f} {gap[1]:7.3f} {gap[2]:7.3f}  "
                f"{f'{falls} falls; ' if falls else ''}{signature(nominal_features, seen)}",
                flush=True,
            )


if __name__ == "__main__":
    print(
        f"{processor()}, model {SimBackend().model_hash[:16]}, true velocity fed back, {SEEDS} seeds a speed"
    )
    main()
