"""A plant's state in a file, as a common start for `sim` and a twin.

The file is a numpy .npz: ``world``, MuJoCo's state; ``pending`` (n, 5, 12), delayed motor commands; ``play`` and
``play_speed`` (12,) of the rotors. See :class:`s2r_sim.plant.plant.Saved`.
"""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np

from s2r_sim.plant.motors import MotorState
from s2r_sim.plant.plant import Saved
from s2r_sim.robot.signals import MotorCommand
from s2r_spec.errors import UsageError


def write_start(path: Path, saved: Saved) -> None:
    """Write a plant's state."""
    motors = saved.motors
    pending = np.array(motors.pending).reshape(-1, 5, 12)
    with path.open("wb") as file:
        np.savez(file, world=saved.world, pending=pending, play=motors.play, play_speed=motors.play_speed)


def read_start(path: Path) -> Saved:
    """Read a state that :func:`write_start` wrote; raise UsageError if the file has other content."""
    try:
        with np.load(path, allow_pickle=False) as file:
            world, pending, play, speed = (file[name] for name in ("world", "pending", "play", "play_speed"))
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise UsageError(f"{path} is not the saved state of a plant: {error}") from None
    if world.ndim != 1 or pending.shape[1:] != (5, 12) or play.shape != (12,) or speed.shape != (12,):
        raise UsageError(f"{path} is not the saved state of a plant: its arrays have other shapes")
    return Saved(world, MotorState(tuple(MotorCommand(*command) for command in pending), play, speed))
