"""Memory and time to read many fast topics of one bag, beside one topic of the same bag.

python -m benchmarks.logs.many_topics [TOPICS] [MINUTES]

The bag (MCAP) is made in a temporary folder: velocities at 1 kHz, with headers, on 12 topics for 10 minutes. For one
topic and for all of them, a process of its own reads one field of each by ``RosBag.read``, and another runs
``s2r monitor``. The CPU time and the peak of memory of each are printed.
"""

from __future__ import annotations

import argparse
import json
import struct
import subprocess
import sys
import tempfile
from pathlib import Path

EPOCH = 1_790_000_000
KIND = "geometry_msgs/msg/TwistStamped"
READ = """\
import sys
from pathlib import Path
from s2r_spec.logs.topics.rosbag import RosBag
wanted = {topic: ["twist.linear.x"] for topic in sys.argv[2:]}
assert {len(one) for one in RosBag(Path(sys.argv[1])).read(wanted, "header").values()} != {0}
"""


def write(bag: Path, topics: list[str], minutes: float) -> None:
    from rosbags.rosbag2 import Writer
    from rosbags.rosbag2.enums import StoragePlugin
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    zero = types["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
    stamp = types["builtin_interfaces/msg/Time"](sec=1, nanosec=2)
    message = types[KIND](
        header=types["std_msgs/msg/Header"](stamp=stamp, frame_id="base"),
        twist=types["geometry_msgs/msg/Twist"](linear=zero, angular=zero),
    )
    raw = bytearray(store.serialize_cdr(message, KIND))
    place = raw.index(struct.pack("<II", 1, 2))
    with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = [writer.add_connection(topic, KIND, typestore=store) for topic in topics]
        for tick in range(int(minutes * 60_000)):
            seconds, rest = EPOCH + tick // 1000, tick % 1000
            struct.pack_into("<d", raw, len(raw) - 48, rest * 1e-3)
            for number, connection in enumerate(connections):
                nanoseconds = rest * 10**6 + number * 50_000  # no two topics have a stamp in common
                struct.pack_into("<II", raw, place, seconds, nanoseconds)
                writer.write(connection, seconds * 10**9 + nanoseconds, bytes(raw))


def run(*words: object) -> dict[str, float]:
    """Return CPU time [s] and peak of memory [MB] of a Python process."""
    code = "import resource, subprocess, sys; subprocess.run(sys.argv[1:], check=True, capture_output=True); "
    code += "used = resource.getrusage(resource.RUSAGE_CHILDREN); "
    code += "print(used.ru_utime + used.ru_stime, used.ru_maxrss / 1e3)"
    command = [sys.executable, "-c", code, sys.executable, *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    seconds, peak = map(float, done.stdout.split())
    return {"cpu_s": round(seconds, 1), "peak_MB": round(peak)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("topics", type=int, nargs="?", default=12)
    parser.add_argument("minutes", type=float, nargs="?", default=10.0)
    given = parser.parse_args()
    topics = [f"/t{number}" for number in range(given.topics)]
    result = {}
    with tempfile.TemporaryDirectory() as name:
        bag, spec = Path(name) / "bag", Path(name) / "spec.stl"
        write(bag, topics, given.minutes)
        for chosen in (topics[:1], topics):
            names = [f"v{number}" for number in range(len(chosen))]
            lines = [f"signal {one} {{m/s}}" for one in names]
            lines.append("require r: always (" + " and ".join(f"{one} <= 5 {{m/s}}" for one in names) + ")")
            spec.write_text("\n".join(lines) + "\n")
            mapped = [
                word
                for one, topic in zip(names, chosen, strict=True)
                for word in ("-m", f"{one}={topic}.twist.linear.x")
            ]
            result[f"{len(chosen)} topics"] = {
                "read": run("-c", READ, bag, *chosen),
                "s2r monitor": run("-m", "s2r_spec", "monitor", spec, bag, *mapped),
            }
    print(json.dumps(result, indent=2))


if __name__ == "__main__":
    main()
