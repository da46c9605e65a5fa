"""Memory and time to evaluate one drive in a large ROS 2 bag, most of it camera pictures.

python -m benchmarks.logs.big_bag [GIGABYTES] [--write]

The bag (MCAP) is made in a temporary folder: odometry at 50 Hz, a command at 20 Hz, and pictures that fill the rest.
``s2r log`` lists it and ``s2r monitor --when`` evaluates its episodes. Each runs in a process of its own, whose peak of
memory is measured. ``s2r --version`` is the measure of this machine's speed.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

RESULT = Path(__file__).parents[1] / "results" / "big_bag.json"
EPOCH = 1_790_000_000 * 10**9
PICTURE = 640 * 480 * 3
SPEC = """\
signal vx {m/s}
param vd {m/s} in [0, 0.5]
require reaches: always[0.5 s, 1.5 s] (abs(vx - vd) <= 0.05 {m/s})
"""


def write(folder: Path, gigabytes: float) -> Path:
    from rosbags.rosbag2 import Writer
    from rosbags.rosbag2.enums import StoragePlugin
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    pictures = int(gigabytes * 1e9 / PICTURE)
    zero = types["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
    kinds = {
        "/odom": "geometry_msgs/msg/Twist",
        "/cmd_vel": "geometry_msgs/msg/Twist",
        "/camera": "sensor_msgs/msg/Image",
    }

    def twist(x):
        return types[kinds["/odom"]](
            linear=types["geometry_msgs/msg/Vector3"](x=x, y=0.0, z=0.0), angular=zero
        )

    header = types["std_msgs/msg/Header"](
        stamp=types["builtin_interfaces/msg/Time"](sec=0, nanosec=0), frame_id="camera"
    )
    pixels = np.random.default_rng(0).integers(0, 256, PICTURE, dtype=np.uint8)
    picture = store.serialize_cdr(
        types[kinds["/camera"]](
            header=header, height=480, width=640, encoding="rgb8", is_bigendian=0, step=1920, data=pixels
        ),
        kinds["/camera"],
    )
    bag = folder / "bag"
    with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        made = {topic: writer.add_connection(topic, kind, typestore=store) for topic, kind in kinds.items()}
        vx = 0.0
        for tick in range(pictures * 10 // 3):  # 100 Hz; 30 pictures a second
            at, seconds = EPOCH + tick * 10**7, tick / 100
            command = 0.3 if seconds % 5 >= 3 else 0.0
            vx += (command - vx) * 0.01 / 0.1
            if tick % 2 == 0:
                writer.write(made["/odom"], at, store.serialize_cdr(twist(vx), kinds["/odom"]))
            if tick % 5 == 0:
                writer.write(made["/cmd_vel"], at, store.serialize_cdr(twist(command), kinds["/cmd_vel"]))
            if tick % 10 in (0, 3, 6):
                writer.write(made["/camera"], at, picture)
    return bag


def run(*words: object) -> dict[str, object]:
    """Return seconds, peak of memory [MB], and lines of a command."""
    began = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", "s2r_spec", *map(str, words)], capture_output=True, text=True, check=False
    )
    seconds = time.perf_counter() - began
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1e3
    return {
        "seconds": round(seconds, 2),
        "peak_MB": round(peak),
        "exit": done.returncode,
        "lines": done.stdout.count("\n"),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("gigabytes", type=float, nargs="?", default=1.0)
    parser.add_argument("--write", action="store_true")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        bag = write(folder, given.gigabytes)
        (folder / "spec.stl").write_text(SPEC)
        size = sum(file.stat().st_size for file in bag.iterdir())
        idle = run("--version")
        listed = run("log", bag)
        read = ("-m", "vx=/odom.linear.x", "-m", "vx_cmd=/cmd_vel.linear.x", "-p", "vd=/cmd_vel.linear.x@0")
        evaluated = run("monitor", folder / "spec.stl", bag, *read, "--when", "vx_cmd > 0.05")
    result = {
        "bag_MB": round(size / 1e6),
        "s2r --version": idle,
        "s2r log": listed,
        "s2r monitor --when": evaluated,
    }
    print(json.dumps(result, indent=2))
    if given.write:
        RESULT.write_text(json.dumps(result, indent=2) + "\n")


if __name__ == "__main__":
    main()
