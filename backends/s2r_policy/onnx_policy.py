"""Policies in ONNX files, evaluated by onnxruntime on one thread.

The file has an input (width,) or (1, width) of 32-bit floats, and an output with the action. A recurrent policy has
further inputs, each with an output of the same shape that holds its next value. Isaac Lab calls them ``obs, h_in,
c_in`` and ``actions, h_out, c_out``. These states begin at zero.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import prod
from pathlib import Path
from threading import Timer
from typing import Any

import numpy as np

from s2r_policy.onnx_file import STANDARD_DOMAINS, Contents, DamagedError, external_files, read_contents
from s2r_policy.policy import FloatArray32, digest, refuse_width
from s2r_spec.errors import UsageError, one_of

_SIDE = re.compile(r"(?i)(^|[_./-])(in|out|input|output|next|new|prev|previous|last)(?=$|[_./-])")
_OBSERVATION = re.compile(r"(?i)(^|[_./-])obs")
_ACTION = re.compile(r"(?i)^(continuous_)?action")
LARGEST = 1_000_000
"""Budget: numbers in an input or an output. The largest policies have some 10,000."""
LONGEST = 10.0
"""Budget: time of the evaluation that opens a policy [s]; a file's loop may have no end."""


@dataclass(frozen=True)
class Port:
    """An input or an output: its name, its type, and its shape, with None for a size that the file leaves open."""

    name: str
    type: str
    shape: tuple[int | None, ...]

    @classmethod
    def of(cls, value: Any) -> Port:
        """Return an input or an output of a session."""
        sizes = tuple(size if isinstance(size, int) and size > 0 else None for size in value.shape)
        return cls(value.name, value.type, sizes)

    @property
    def is_vector(self) -> bool:
        """Whether it is a vector, perhaps in a batch of one."""
        return bool(self.shape) and all(size in (1, None) for size in self.shape[:-1])

    def filled(self, size: int | None = None) -> FloatArray32:
        """Return zeros in this shape; ``size`` is the last size, if the file leaves it open."""
        sizes = [one or 1 for one in self.shape]
        return np.zeros(sizes if size is None else [*sizes[:-1], size], np.float32)


@dataclass(frozen=True)
class Ports:
    """The inputs and outputs of a policy: observation, action, and pairs of a state and its next value.

    ``notes`` has a sentence for every pair whose names do not match, and for every output that is not used.
    """

    observation: Port
    action: Port
    states: tuple[tuple[Port, Port], ...]
    notes: tuple[str, ...]


class OnnxPolicy:
    """A policy in an ONNX file; see :class:`s2r_policy.Policy`."""

    def __init__(self, path: Path) -> None:
        """Open the file.

        Raises:
            UsageError: as :func:`s2r_policy.open_policy`.
        """
        import onnxruntime

        contents = _read(path)
        self.path = path
        self.files = (path, *external_files(path, contents.locations))
        self._session = _open(path, contents)
        self._ports = sort_ports(
            path,
            [Port.of(one) for one in self._session.get_inputs()],
            [Port.of(one) for one in self._session.get_outputs()],
        )
        self.metadata: Mapping[str, str] = dict(self._session.get_modelmeta().custom_metadata_map)
        self.digest = digest(self.files, f"onnxruntime {onnxruntime.__version__}")
        self.notes = self._ports.notes
        self.recurrent = bool(self._ports.states)
        self.width = self._ports.observation.shape[-1]
        self.outputs = self._ports.action.shape[-1]
        self._input: FloatArray32 | None = None
        if self.width is not None:
            self._bind(self.width)

    def reset(self) -> None:
        """Set every state to zeros."""
        for state, _ in self._states if self._input is not None else ():
            state[:] = 0.0

    def __call__(self, observation: FloatArray32) -> FloatArray32:
        """Return the action (outputs,) for an observation (width,).

        Raises:
            UsageError: the observation has another width, or the file cannot be evaluated.
        """
        if self._input is None or observation.shape != self._input.shape:
            refuse_width(self.path, self.width, observation)
            self._bind(observation.size)
        assert self._input is not None
        self._input[:] = observation
        self._session.run_with_iobinding(self._binding)
        for state, following in self._states:
            state[:] = following
        return self._action.copy()

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by the path: another process opens the file again."""
        return type(self), (self.path,)

    def _bind(self, width: int) -> None:
        """Bind arrays of this object to inputs and outputs, which saves a copy and a dictionary at every call."""
        ports = self._ports
        observation = ports.observation.filled(width)
        states = [port.filled() for port, _ in ports.states]
        feed = {ports.observation.name: observation}
        feed |= {port.name: state for (port, _), state in zip(ports.states, states, strict=True)}
        names = [ports.action.name, *(following.name for _, following in ports.states)]
        try:
            action, *following = (np.ascontiguousarray(one) for one in _run(self._session, names, feed))
        except Exception as error:
            raise UsageError(
                f"{self.path}: onnxruntime cannot evaluate the policy with {width} numbers: {_first_sentence(error)}"
            ) from None
        self._binding = self._session.io_binding()
        for name, array in feed.items():
            self._binding.bind_cpu_input(name, array)
        for name, array in zip(names, (action, *following), strict=True):
            self._binding.bind_output(name, "cpu", 0, np.float32, array.shape, array.ctypes.data)
        self._states = list(zip(states, following, strict=True))
        self._arrays = (observation, action)  # the binding has only their addresses
        self._input, self._action = observation.reshape(-1), action.reshape(-1)
        self.width, self.outputs = width, self._action.size


def _run(session: Any, names: list[str], feed: Mapping[str, FloatArray32]) -> Any:
    """Return the outputs of a session, which is stopped after :data:`LONGEST` with an error."""
    import onnxruntime

    options = onnxruntime.RunOptions()
    timer = Timer(LONGEST, setattr, (options, "terminate", True))
    timer.start()
    try:
        return session.run(names, feed, options)
    finally:
        timer.cancel()


def sort_ports(path: Path, inputs: Sequence[Port], outputs: Sequence[Port]) -> Ports:
    """Return which input is the observation, which output is the action, and which are states.

    A state is paired with its next value by name (``h_in`` and ``h_out``), else by shape and order.

    Raises:
        UsageError: an input is neither observation nor state, or a type or a shape is not that of a vector of floats.
    """
    named = [
        (one, other)
        for one in inputs
        for other in outputs
        if _stem(one) == _stem(other) != "" and _same(one, other)
    ]
    paired = {port.name for pair in named for port in pair}
    left = [port for port in inputs if port.name not in paired] or list(inputs)
    ends = [port for port in outputs if port.name not in paired] or list(outputs)
    observation = next((port for port in left if _OBSERVATION.search(port.name)), left[0])
    action = next((port for port in ends if _ACTION.search(port.name)), ends[0])
    states = [pair for pair in named if observation not in pair and action not in pair]
    free = [port for port in ends if port != action]
    for port in left:
        if port == observation:
            continue
        other = next((one for one in free if _same(port, one)), None)
        if other is None:
            raise UsageError(
                f"{path}: the policy has an input {port.name!r} that is neither its observation nor a state with an "
                f"output of its own; export the policy without it"
            )
        free.remove(other)
        states.append((port, other))
    used = [observation, action, *(port for pair in states for port in pair)]
    for port in used:
        _refuse_type(path, port)
        if prod(size or 1 for size in port.shape) > LARGEST:
            raise UsageError(
                f"{path}: {port.name!r} has the shape {_shape(port)}; a policy has fewer numbers"
            )
    for role, port in (("observation", observation), ("action", action)):
        if not port.is_vector:
            raise UsageError(
                f"{path}: the {role} {port.name!r} has the shape {_shape(port)}; only a vector (1, N) is supported"
            )
    guessed = [pair for pair in states if pair not in named]
    notes = [
        f"the output {after.name!r} is the next value of the input {state.name!r}" for state, after in guessed
    ]
    notes += [f"the output {port.name!r} is not used" for port in outputs if port not in used]
    return Ports(observation, action, tuple(states), tuple(notes))


def _stem(port: Port) -> str:
    """Return a name without its word for input or output; "" if it has no such word."""
    stem, count = _SIDE.subn("", port.name)
    return stem.lower() if count else ""


def _same(one: Port, other: Port) -> bool:
    """Return whether an output may be the next value of an input."""
    return one.type == other.type and [size or 1 for size in one.shape] == [size or 1 for size in other.shape]


def _shape(port: Port) -> str:
    return f"({', '.join('?' if size is None else str(size) for size in port.shape)})"


def _refuse_type(path: Path, port: Port) -> None:
    if port.type != "tensor(float)":
        raise UsageError(
            f"{path}: {port.name!r} is a {port.type}, but a policy has 32-bit floats, tensor(float); "
            f"export it with them"
        )


def _read(path: Path) -> Contents:
    """Return what a file uses.

    Raises:
        UsageError: it cannot be read, is no ONNX file, or has an operator of its own.
    """
    try:
        contents = read_contents(path.read_bytes())
    except OSError as error:
        raise UsageError(f"{path} cannot be read: {error.strerror or error}") from None
    except DamagedError:
        raise UsageError(f"{path}: the file is no ONNX model, or only a part of one; copy it again") from None
    own = {
        f"{domain}::{name}"
        for domain, name in contents.operators - contents.functions
        if domain not in STANDARD_DOMAINS
    }
    if own:
        raise UsageError(
            f"{path}: the policy uses the custom operator {one_of(own)}; export it with standard operators only"
        )
    return contents


def _open(path: Path, contents: Contents) -> Any:
    """Return a session of onnxruntime with one thread, so that every process computes the same bits."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
    options.log_severity_level = 4  # errors are raised
    try:
        return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except Exception as error:
        newest = re.search(r"till opset (\d+)|max supported IR version: (\d+)", str(error))
        if newest:
            opset, ir = newest.groups()
            words = f"opset {contents.opset}, but onnxruntime {onnxruntime.__version__} runs at most {opset}"
            if ir:
                words = f"a format version (IR) that onnxruntime {onnxruntime.__version__} does not read, above {ir}"
            raise UsageError(
                f"{path}: the file has {words}; upgrade onnxruntime, or export the policy with a lower opset_version"
            ) from None
        raise UsageError(
            f"{path}: onnxruntime {onnxruntime.__version__} cannot open it: {_first_sentence(error)}"
        ) from None


def _first_sentence(error: Exception) -> str:
    """Return what onnxruntime says, without its code, the path of the model, and its own file and function."""
    words = re.sub(r"^\[ONNXRuntimeError\] : \d+ : \w+ : ", "", str(error))
    words = re.sub(r"^Load model from .*? failed:", "", words)
    words = re.sub(r"^\S+\.(?:cc|h):\d+ .*\) (?=[A-Z])", "", words)
    return re.split(r"\.\s|\n", words, maxsplit=1)[0].strip(" .")
