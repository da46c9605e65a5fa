"""Make the traces of the specifications in folders: ``python -m tests.specs.twins`` writes all of them.

No trace is of hardware. The walks are rollouts of the A1's simulator. The others are twins: closed forms and small
simulations of a carrier, an arm and a multicopter, with the fault that each comment names. All samples are rounded.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from s2r_spec.logs import write
from s2r_spec.trace import Trace

FOLDER = Path(__file__).parents[2] / "specs" / "traces"
WORDS = ("holds", "fails")
PUSHED = {"push": 20.0, "push_towards": 90.0, "push_time": 1.5}
"""Parameters of a rollout that a specification does not have: a push of the trunk to the left."""


def trace(times: np.ndarray, params: dict[str, float], **columns: tuple[str, np.ndarray]) -> Trace:
    """Return a trace from name → (unit, samples)."""
    samples = {name: np.round(values, 5) for name, (_, values) in columns.items()}
    units = {name: unit for name, (unit, _) in columns.items() if unit}
    return Trace(np.round(times, 4), samples, units, {"params": params})


def walks() -> Iterator[tuple[str, Trace, Trace]]:
    """Yield name, trace that holds and trace that fails, of the A1's trot at 50 Hz."""
    from s2r_sim import SimBackend

    low = SimBackend()
    low = replace(low, settings=replace(low.settings, gains=replace(low.settings.gains, swing_height=0.03)))
    at, left = {"vd": 0.3}, {"push": 12.0, "push_towards": 90.0}
    rated = at | {"payload": 1.0}
    # Name, duration [s], channels, parameters, and what makes the second rollout fail.
    cases = (
        ("velocity_tracking", 4.0, "vx vy vy_cmd wz wz_cmd", at, PUSHED, None),
        ("velocity_step", 4.0, "vx", at, {"slope": 8.0}, None),
        ("foot_clearance", 2.0, "contact foot_position", at, {}, low),
        ("foot_slip", 2.0, "contact foot_velocity", at | {"friction": 0.8}, {"friction": 0.15}, None),
        ("torque_margin", 2.0, "tau", rated, {"payload": 6.0, "push": 16.0, "push_towards": 180.0}, None),
        ("tilt", 4.0, "roll pitch height", at, PUSHED, None),
        ("push_recovery", 3.0, "vx vy vx_cmd vy_cmd roll pitch", left, {"friction": 0.4}, None),
    )
    for name, duration, channels, params, more, other in cases:
        traces = []
        for added, backend in (({}, SimBackend()), (more, other or SimBackend())):
            rollout = backend.with_duration(duration).rollout(params | added, 0)
            every = slice(None, None, 10)
            columns = {one: (rollout.units.get(one, ""), rollout[one][every]) for one in channels.split()}
            shown = {key: value for key, value in (params | added).items() if key in params}
            traces.append(trace(rollout.times[every], shown, **columns))
        yield name, *traces


def actions(jump: float) -> Trace:
    """Return a gait of 2 Hz as actions at 50 Hz, with white noise of this standard deviation."""
    times = np.arange(101) * 0.02
    phase = 2 * np.pi * 2.0 * times[:, None] + np.arange(12) * np.pi / 3
    noise = np.random.default_rng(0).normal(scale=jump, size=phase.shape)
    return trace(times, {"vd": 0.5}, action=("", 0.4 * np.sin(phase) + noise))


def docking(left: float) -> Trace:
    """Return an approach in the dock's frame by polar feedback; the robot sees the dock too far to the left [m]."""
    step, x, y, yaw = 0.02, -1.0, 0.2, -0.2
    rows = []
    for _ in range(1601):
        far = np.hypot(-x, left - y)
        bearing = np.arctan2(left - y, -x) - yaw
        v = min(0.25, 0.3 * far) if far > 0.01 else 0.0
        w = 1.5 * bearing - 0.6 * (yaw + bearing) if far > 0.01 else -0.6 * yaw
        rows.append((x, y, yaw, v))
        x, y, yaw = x + step * v * np.cos(yaw), y + step * v * np.sin(yaw), yaw + step * w
    sampled = np.array(rows)[::10]
    columns = zip(("x", "y", "yaw", "v"), ("m", "m", "rad", "m/s"), sampled.T, strict=True)
    params = {"y0": 0.2, "yaw0": -11.5}
    return trace(np.arange(161) * 0.2, params, **{name: (unit, values) for name, unit, values in columns})


def stopping(reaction: float) -> Trace:
    """Return a stop from 1.2 m/s at 1.1 m/s², requested at 1 s, after a reaction [s]."""
    times = np.arange(126) * 0.04
    v = np.clip(1.2 - 1.1 * (times - 1 - reaction), 0.0, 1.2)
    return trace(times, {"v0": 1.2}, stop=("", (times >= 1) * 1.0), v=("m/s", v))


def joints(payload: float) -> Trace:
    """Return six joints on cosines of 2 s, 20 ms late; the load bends the second and the third."""
    times = np.arange(101) * 0.04
    ends = np.array([0.6, -0.5, 0.8, 0.4, -0.7, 0.5])

    def reference(at: np.ndarray) -> np.ndarray:
        return ends * (1 - np.cos(np.pi * np.clip(at, 0, 2) / 2))[:, None] / 2

    sag = payload * np.array([0, 0.012, 0.008, 0, 0, 0]) * np.minimum(1, times / 0.2)[:, None]
    q = reference(times - 0.02) - sag
    speed = (reference(times - 0.019) - reference(times - 0.021)) / 0.002
    columns = {"q": ("rad", q), "dq": ("rad/s", speed), "target": ("rad", reference(times))}
    return trace(times, {"payload": payload}, **columns)


def path(speed: float) -> Trace:
    """Return an arc of 0.2 m radius at a constant speed [m/s], 4 ms late along the path, and inside it."""
    times = np.arange(101) * 0.02
    angle = speed * times / 0.2
    inside = 0.2 * (1 - 0.02 * speed**2 / 0.25)
    late = speed * 0.004 / 0.2

    def arc(radius: float, at: np.ndarray) -> np.ndarray:
        return np.stack([0.4 + radius * np.cos(at), radius * np.sin(at), 0.3 + 0 * at], axis=1)

    return trace(
        times, {"speed": speed}, tip=("m", arc(inside, angle - late)), tip_ref=("m", arc(0.2, angle))
    )


def set_point(payload: float) -> Trace:
    """Return a move of 0.3 m under a controller whose damping falls with the load [kg]."""
    times = np.arange(151) * 0.02
    goal = np.array([0.4, 0.3, 0.2])
    off = response(times, 9.0 / (1 + 0.1 * payload), 0.97 - 0.2 * payload)[:, None] - 1
    tip = goal + off * np.array([0.0, 0.3, 0.0])
    return trace(times, {"payload": payload}, tip=("m", tip), goal=("m", np.tile(goal, (151, 1))))


def response(times: np.ndarray, frequency: float, damping: float) -> np.ndarray:
    """Return the unit step response of a second-order system, from its frequency [rad/s] and damping ratio < 1."""
    swing = frequency * np.sqrt(1 - damping**2)
    ratio = damping / np.sqrt(1 - damping**2)
    return 1 - np.exp(-damping * frequency * times) * (np.cos(swing * times) + ratio * np.sin(swing * times))


def hover(wind: float) -> Trace:
    """Return a hover that gusts move by 6 cm for each m/s of wind."""
    times = np.arange(101) * 0.1
    x = 0.06 * wind * np.sin(2 * np.pi * 0.15 * times)
    y = 0.03 * wind * np.sin(2 * np.pi * 0.22 * times)
    z = 5 + 0.02 * wind * np.sin(2 * np.pi * 0.1 * times)
    positions = {"x": ("m", x), "y": ("m", y), "z": ("m", z)}
    speeds = {"vx": ("m/s", np.gradient(x, 0.1)), "vy": ("m/s", np.gradient(y, 0.1))}
    return trace(times, {"wind": wind}, **positions, **speeds)


def step(damping: float) -> Trace:
    """Return a step of 2 m; the tilt is the acceleration over that of gravity."""
    times = np.arange(161) * 0.05
    x = 2.0 * response(times, 1.6, damping)
    pitch = np.arctan(np.gradient(np.gradient(x, 0.05), 0.05) / 9.81)
    return trace(times, {"step": 2.0}, x=("m", x), roll=("rad", 0 * times), pitch=("rad", pitch))


def flight(drop: float) -> bytes:
    """Return a PX4 log: take-off, a square of 4 m, landing. The vehicle drops by this height [m] for 2 s at 20 s."""
    times = np.arange(201) * 0.2
    up = np.interp(times, [2, 7, 33, 38], [0.0, 5, 5, 0])
    north = np.interp(times, [10, 13, 17, 20, 24, 27], [0.0, 4, 4, 4, 4, 0])
    east = np.interp(times, [13, 17, 24, 27, 30], [0.0, 0, 4, 4, 0])
    lag = 0.3 * np.gradient(north, 0.2), 0.3 * np.gradient(east, 0.2)
    fallen = drop * ((times >= 20) & (times < 22))
    pitch, still = -0.1 * np.gradient(north, 0.2), 0 * times
    flies = (times > 2) & (times < 38)
    topics = {
        "vehicle_local_position": {"x": north - lag[0], "y": east - lag[1], "z": fallen - up},
        "vehicle_local_position_setpoint": {
            "x": np.where(flies, north, np.nan),
            "y": np.where(flies, east, np.nan),
            "z": np.where(flies, -up, np.nan),
        },
        "vehicle_attitude": {"q[4]": np.stack([np.cos(pitch / 2), still, np.sin(pitch / 2), still], axis=1)},
        "vehicle_land_detected": {"landed": ~flies},
        "estimator_status": {"pos_test_ratio": 0.1 + 0.05 * flies, "hgt_test_ratio": 0.1 + 0.2 * fallen},
        "vehicle_imu_status": {"accel_vibration_metric": 0.1 + 2.0 * flies},
        "battery_status": {"remaining": 0.9 - 0.01 * times},
    }
    return ulog(topics, times)


def ulog(topics: dict[str, dict[str, np.ndarray]], times: np.ndarray) -> bytes:
    """Return a log, as https://docs.px4.io/main/en/dev_log/ulog_file_format says; the first three topics at 5 Hz."""

    def message(kind: bytes, data: bytes) -> bytes:
        return struct.pack("<HB", len(data), ord(kind)) + data

    def field(name: str, values: np.ndarray) -> str:
        bare, _, size = name.partition("[")
        return f"{'bool' if values.dtype == bool else 'float'}{'[' * bool(size)}{size} {bare};"

    written = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0) + message(b"B", bytes(40))
    for name, columns in topics.items():
        fields = "".join(field(key, values) for key, values in columns.items())
        written += message(b"F", f"{name}:uint64_t timestamp;{fields}".encode())
    for number, name in enumerate(topics):
        written += message(b"A", struct.pack("<BH", 0, number) + name.encode())
    for k, at in enumerate(times):
        for number, columns in enumerate(topics.values()):
            if number < 3 or k % 5 == 0:
                data = struct.pack("<HQ", number, 1_000_000 + round(at * 1e6))
                for values in columns.values():
                    data += values[k].astype(bool if values.dtype == bool else "<f4").tobytes()
                written += message(b"D", data)
    return written


TWINS = {
    "legged/action_smoothness": (lambda: actions(0.01), lambda: actions(0.5)),
    "wheeled/docking": (lambda: docking(0.0), lambda: docking(0.08)),
    "wheeled/stop_distance": (lambda: stopping(0.08), lambda: stopping(0.3)),
    "arm/joint_tracking": (lambda: joints(0.5), lambda: joints(3.0)),
    "arm/path_accuracy": (lambda: path(0.2), lambda: path(0.5)),
    "arm/set_point": (lambda: set_point(0.5), lambda: set_point(3.0)),
    "aerial/hover": (lambda: hover(3.0), lambda: hover(8.0)),
    "aerial/step": (lambda: step(0.8), lambda: step(0.4)),
}
"""Specification → the trace that holds and the one that fails."""
FLIGHTS = {"holds": 0.0, "fails": 1.2}
"""Drop of the vehicle in the two logs of ``aerial/flight_log`` [m]."""


def main() -> None:
    """Write all traces."""
    for kind in ("legged", "wheeled", "arm", "aerial"):
        (FOLDER / kind).mkdir(exist_ok=True)
    made = {name: tuple(make() for make in pair) for name, pair in TWINS.items()}
    made |= {f"legged/{name}": traces for name, *traces in walks()}
    for name, traces in made.items():
        for word, one in zip(WORDS, traces, strict=True):
            write(one, FOLDER / f"{name}_{word}.csv")
    for word, drop in FLIGHTS.items():
        (FOLDER / f"aerial/flight_log_{word}.ulg").write_bytes(flight(drop))


if __name__ == "__main__":
    main()
