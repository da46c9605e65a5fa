"""Small robots that the tests write: a box with four legs, and a folder of files for each."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from s2r_spec.backend import load_backend
from s2r_spec.trace import Trace
from tests.mujoco.make_policies import linear

LEGS = ("fl", "fr", "rl", "rr")
OTHER = ("rr", "fl", "rl", "fr")
"""Another order of the same joints."""
SPIN = "start = { height = 1.0, noise = { joint_pos = 0.2, joint_vel = 1, base_lin_vel = 0.5, base_ang_vel = 1 } }\n"
"""A start in the air that tumbles."""


def quadruped(
    legs: Sequence[str] = LEGS, actuator: str = "", options: str = 'timestep="0.005"', extra: str = ""
) -> str:
    """Return the XML of a floating box with four legs of one hinge each, in this order of joints and motors."""
    places = {leg: f"{0.2 if leg[0] == 'f' else -0.2} {0.1 if leg[1] == 'l' else -0.1} 0" for leg in LEGS}
    bodies = "".join(
        f'<body name="{leg}" pos="{places[leg]}"><joint name="{leg}" axis="0 1 0" range="-1.2 1.5" limited="true" '
        f'armature="0.01"/><geom name="{leg}" type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="0.2"/></body>'
        for leg in legs
    )
    motors = "".join(actuator.format(leg=leg) or f'<motor name="{leg}" joint="{leg}"/>' for leg in legs)
    return f"""<mujoco model="box">
      <compiler angle="radian"/><option {options}/>
      <worldbody>
        <geom name="floor" type="plane" size="0 0 0.1"/>
        <body name="trunk" pos="0 0 0.25"><freejoint name="root"/>
          <geom name="trunk" type="box" size="0.25 0.12 0.05" mass="3"/>
          <site name="imu" pos="0.1 0.02 0.05" euler="0.3 0.5 0.7"/>{bodies}
        </body>
      </worldbody>
      <actuator>{motors}</actuator>
      <sensor>
        <gyro name="gyro" site="imu"/><velocimeter name="velocimeter" site="imu"/>
        <framequat name="imu_attitude" objtype="site" objname="imu"/>
        <accelerometer name="accelerometer" site="imu"/>
        <jointpos name="height" joint="{legs[0]}"/>
      </sensor>
      {extra}
    </mujoco>"""


def weights(outputs: int, width: int, size: float = 0.1, seed: int = 0) -> np.ndarray:
    """Return random weights (outputs, width) of a linear policy."""
    return size * np.random.default_rng(seed).standard_normal((outputs, width))


def save(folder: Path, name: str, model: Any) -> None:
    """Write an ONNX model."""
    (folder / name).write_bytes(model.SerializeToString())


def robot(
    folder: Path, text: str, width: int | None = None, model: str | None = None, outputs: int = 4
) -> Any:
    """Write model, linear policy of this width and ``robot.toml``, and return the backend."""
    (folder / "box.xml").write_text(model or quadruped())
    head = 'model = "box.xml"\n'
    if width is not None:
        save(folder, "policy.onnx", linear(weights(outputs, width)))
        head += 'policy = "policy.onnx"\n'
    return opened(folder, head + text)


def opened(folder: Path, text: str) -> Any:
    """Write ``robot.toml`` and return the backend."""
    (folder / "robot.toml").write_text(text)
    return load_backend(str(folder / "robot.toml"))


def same(one: Trace, other: Trace) -> bool:
    """Return whether two traces are equal bit for bit."""
    return list(one.channels) == list(other.channels) and all(
        np.array_equal(one[name], other[name], equal_nan=True) for name in one.channels
    )
