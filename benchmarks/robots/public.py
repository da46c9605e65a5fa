"""Public robots from their own files: do they walk as stated, and what does a rollout cost beside a bare loop?

Run: OMP_NUM_THREADS=1 python -m benchmarks.robots.public

The robots are those of ``shared/robots`` beside the checkout, which are not in the repository. Their robot files are
below: at most 12 lines each, and no code. A bare loop makes the same physics steps and inferences as the robot's own
files ask for, and records nothing.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from time import process_time

import mujoco
import numpy as np
import onnxruntime as ort

from benchmarks.machine import processor
from s2r_spec import load_backend

ROOT = Path(__file__).parents[2]
ROBOTS = ROOT.parent / "shared" / "robots"
RESULT = ROOT / "benchmarks" / "results" / "public_robots.json"
SEEDS, REPEATS = 20, 40
FELL = 'failure.fell = "max(abs(roll), abs(pitch)) > 60 {deg} or height < 0.6 * init(height)"'
NOISE = "start.noise = { joint_pos = 0.02, joint_vel = 0.05 }"

GO1 = f"""\
model = "{ROBOTS}/go1_playground/scene_mjx_feetonly_flat_terrain.xml"
policy = "{ROBOTS}/go1_playground/go1_policy.onnx"
keyframe = "home"
decimation = 5
observation = [{{ sensor = "local_linvel" }}, {{ sensor = "gyro" }}, {{ term = "projected_gravity", frame = "imu" }},
  "joint_pos_rel", "joint_vel", "last_action", "velocity_commands"]
action.scale = 0.5
command.lin_vel_x = "vd"
{NOISE}
{FELL}
"""
BERKELEY = f"""\
model = "{ROBOTS}/berkeley_humanoid_playground/scene_mjx_feetonly_flat_terrain.xml"
policy = "{ROBOTS}/berkeley_humanoid_playground/bh_policy.onnx"
keyframe = "home"
decimation = 10
observation = [{{ sensor = "local_linvel" }}, {{ sensor = "gyro" }}, {{ term = "projected_gravity", frame = "imu" }},
  "velocity_commands", "joint_pos_rel", "joint_vel", "last_action",
  {{ phase = 1.5, unit = "Hz", start = [0, 3.14159], as = ["cos", "sin"] }}]
action.scale = 0.5
command.lin_vel_x = "vd"
{NOISE}
{FELL}
"""
G1_LSTM = f"""\
model = "{ROBOTS}/g1_unitree_rl_gym/scene.xml"
policy = "{ROBOTS}/g1_unitree_rl_gym/motion.pt"
deploy = "{ROBOTS}/g1_unitree_rl_gym/g1.yaml"
start.joint_pos = "model"
command.lin_vel_x = "vd"
{NOISE}
{FELL}
"""
G1_LAB = f"""\
model = "{ROBOTS}/g1_unitree_rl_lab/g1_29dof.xml"
policy = "{ROBOTS}/g1_unitree_rl_lab/policy.onnx"
deploy = "{ROBOTS}/g1_unitree_rl_lab/deploy.yaml"
command.lin_vel_x = "vd"
{NOISE}
{FELL}
"""
CASES = (
    ("Go1, playground", GO1, 0.5, 0.512),
    ("Berkeley humanoid, playground", BERKELEY, 0.3, 0.252),
    ("Berkeley humanoid, playground", BERKELEY, 0.5, 0.456),
    ("G1, unitree_rl_gym (LSTM)", G1_LSTM, 0.5, None),
    ("G1, unitree_rl_lab (deploy.yaml)", G1_LAB, 0.5, None),
)
"""Robot, robot file, command [m/s], mean vx from 2 to 5 s that shared/robots/README.md states [m/s]."""


def write(folder: Path, name: str, text: str) -> str:
    """Write a robot file, and return its path."""
    path = folder / f"{name}.toml"
    path.write_text(text)
    return str(path)


def walks(folder: Path) -> list[dict[str, object]]:
    """Return mean vx of each robot over some seeds, beside the stated one."""
    rows = []
    for robot, text, command, stated in CASES:
        assert len(text.splitlines()) <= 12
        backend = load_backend(write(folder, "robot", text)).with_duration(5.0)
        traces = [backend.rollout({"vd": command}, seed) for seed in range(SEEDS)]
        speeds = [float(trace["vx"][trace.times >= 2.0].mean()) for trace in traces if trace.failure is None]
        row = {"robot": robot, "command": command, "stated": stated, "falls": SEEDS - len(speeds)}
        row |= {"mean_vx": round(float(np.mean(speeds)), 4), "deviation": round(float(np.std(speeds)), 4)}
        row["lines"] = len(text.splitlines())
        rows.append(row)
    return rows


def bare_go1() -> Callable[[], None]:
    """Return a bare loop of 1.5 s of the Go1: 75 inferences and 375 physics steps."""
    folder = ROBOTS / "go1_playground"
    model = mujoco.MjModel.from_xml_path(str(folder / "scene_mjx_feetonly_flat_terrain.xml"))
    data, options = mujoco.MjData(model), ort.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = ort.InferenceSession(str(folder / "go1_policy.onnx"), options)
    home, command = np.array(model.keyframe("home").qpos[7:]), np.array([0.5, 0.0, 0.0])
    velocity, gyro = data.sensor("local_linvel").data, data.sensor("gyro").data
    attitude = data.site_xmat[model.site("imu").id].reshape(3, 3)

    def loop() -> None:
        mujoco.mj_resetDataKeyframe(model, data, 0)
        mujoco.mj_forward(model, data)
        action = np.zeros(12, dtype=np.float32)
        for _ in range(75):
            parts = velocity, gyro, -attitude[2], data.qpos[7:] - home, data.qvel[6:], action, command
            action = session.run(None, {"obs": np.concatenate(parts).astype(np.float32)[None]})[0][0]
            data.ctrl[:] = home + 0.5 * action
            mujoco.mj_step(model, data, nstep=5)

    return loop


def speed(folder: Path) -> dict[str, object]:
    """Return CPU time of a rollout of the Go1 with every channel, beside the bare loop, in turns."""
    backend = load_backend(write(folder, "go1", GO1)).with_duration(1.5)
    backend.prepare()
    ways = {"bare loop": bare_go1(), "all channels": lambda: backend.rollout({"vd": 0.5}, 0)}
    times: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(REPEATS):
        for name, way in ways.items():
            begin = process_time()
            way()
            times[name].append(process_time() - begin)
    bare, ours = (median(times[name]) for name in ways)
    return {"bare_ms": round(1e3 * bare, 2), "ours_ms": round(1e3 * ours, 2), "ratio": round(ours / bare, 2)}


def main() -> None:
    """Print the tables, and write them to the file of results."""
    if not ROBOTS.is_dir():
        sys.exit(f"{ROBOTS} is missing: the public robots are not in the repository")
    with TemporaryDirectory() as name:
        result = {
            "machine": processor(),
            "seeds": SEEDS,
            "walks": walks(Path(name)),
            "go1_of_1.5_s": speed(Path(name)),
        }
    for row in result["walks"]:
        print(row)
    print(result["go1_of_1.5_s"])
    RESULT.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
