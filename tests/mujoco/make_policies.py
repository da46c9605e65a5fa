"""Policies that the tests use: a cart-pole's linear-quadratic regulator as ONNX files of less than 1 kB.

The regulator is linear, so the files hold one Gemm with its gains. A network fitted to it would only add an error, and
its weights would depend on the optimizer. ``cart.onnx`` returns a force. ``cart_mjlab.onnx`` returns an action that
moves the target of a PD law, and has the metadata that mjlab's exporter writes.

Run it as ``python -m tests.mujoco.make_policies --write``.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

HERE = Path(__file__).parent
DECIMATION = 4
COST = np.diag([1.0, 10.0, 0.1, 0.1])
"""Cost of x [m], θ [rad] and their rates; that of the input is 0.01 a N² or 1 a rad²."""
KP, KD, SCALE = 60.0, 12.0, 0.5
METADATA = {
    "run_path": "s2r/tests",
    "joint_names": "slide",
    "joint_stiffness": f"{KP:.3f}",
    "joint_damping": f"{KD:.3f}",
    "default_joint_pos": "0.000",
    "command_names": "",
    "observation_names": "joint_pos,joint_vel",
    "action_scale": f"{SCALE:.3f}",
}


def gains(model: Any, cost: float) -> np.ndarray:
    """Return K (1, 4) of u = −K (x, θ, ẋ, θ̇): the regulator at the control period of the model's linearization."""
    from scipy.linalg import solve_discrete_are

    data, n = mujoco.MjData(model), 2 * model.nv
    A, B = np.zeros((n, n)), np.zeros((n, model.nu))
    mujoco.mj_forward(model, data)
    mujoco.mjd_transitionFD(model, data, 1e-6, True, A, B, None, None)
    held = sum(np.linalg.matrix_power(A, i) @ B for i in range(DECIMATION))
    A = np.linalg.matrix_power(A, DECIMATION)
    P = solve_discrete_are(A, held, COST, np.array([[cost]]))
    return np.linalg.solve(cost + held.T @ P @ held, held.T @ P @ A)


def with_gains() -> Any:
    """Return the cart-pole whose motor is a position actuator with the gains of the metadata."""
    spec = mujoco.MjSpec.from_file(str(HERE / "cart.xml"))
    motor = spec.actuators[0]
    motor.ctrllimited, motor.biastype = 0, mujoco.mjtBias.mjBIAS_AFFINE
    motor.gainprm[0], motor.biasprm[1], motor.biasprm[2] = KP, -KP, -KD
    return spec.compile()


def linear(weights: np.ndarray, metadata: dict[str, str] | None = None, opset: int = 17) -> Any:
    """Return an ONNX model of the policy a = W o, with ``obs`` (1, width) and ``actions`` (1, outputs)."""
    from onnx import TensorProto, helper, numpy_helper

    outputs, width = weights.shape
    node = helper.make_node("Gemm", ["obs", "W"], ["actions"], transB=1)
    graph = helper.make_graph(
        [node],
        "policy",
        [helper.make_tensor_value_info("obs", TensorProto.FLOAT, [1, width])],
        [helper.make_tensor_value_info("actions", TensorProto.FLOAT, [1, outputs])],
        [numpy_helper.from_array(weights.astype(np.float32), "W")],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)], ir_version=9)
    helper.set_model_props(model, metadata or {})
    return model


def policies() -> dict[str, Any]:
    """Return name → ONNX model of the committed policies."""
    torque = mujoco.MjModel.from_xml_path(str(HERE / "cart.xml"))
    return {
        "cart.onnx": linear(-gains(torque, 0.01)),
        "cart_mjlab.onnx": linear(-gains(with_gains(), 1.0) / SCALE, METADATA),
    }


def weights(model: Any) -> np.ndarray:
    """Return the weights of a linear policy."""
    from onnx import numpy_helper

    return numpy_helper.to_array(model.graph.initializer[0])


if __name__ == "__main__":
    for name, model in policies().items():
        print(name, weights(model), len(model.SerializeToString()), "bytes")
        if "--write" in sys.argv:
            (HERE / name).write_bytes(model.SerializeToString())
