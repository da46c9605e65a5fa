"""A model hash says which model it is, in every process."""

import os
import subprocess
import sys

from s2r_spec.backend import load_backend

NAMES = (
    "turtlebot",
    "turtlebot:motor_lag.time=0.3",
    "turtlebot:latency.delay=0.1",
    "emps",
    "emps:mass.extra=5",
    "sim",
    "sim:latency.delay=0.004",
    "twin:ramp",
    "a1:host=127.0.0.1,velocity=onboard",
    "a1:host=127.0.0.1,velocity=mocap:9000,heading=3",
)


def test_another_process_finds_the_same_model():
    code = f"from s2r_spec.backend import load_backend\nfor n in {NAMES!r}: print(load_backend(n).model_hash)"
    environment = os.environ | {"PYTHONHASHSEED": "7"}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment
    )
    assert done.stdout.split() == [load_backend(name).model_hash for name in NAMES]


def test_models_that_differ_have_hashes_that_differ():
    hashes = [load_backend(name).model_hash for name in NAMES]
    assert len(set(hashes)) == len(hashes)
    other = load_backend("turtlebot:motor_lag.time=0.2")
    assert other.model_hash != load_backend("turtlebot:motor_lag.time=0.3").model_hash
