"""The `a1` backend: Unitree's A1 or its twin, behind the guard that keeps it safe."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import InitVar, dataclass, field, replace
from functools import cache
from importlib.metadata import version
from importlib.util import find_spec
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Self

import numpy as np

from s2r_a1.channels import channels
from s2r_a1.guard.place import RobotAddress
from s2r_a1.mocap import Placing, read_placing
from s2r_a1.options import EXAMPLE, OFFERED, Options, read_options, write_options
from s2r_a1.protocols import PROTOCOLS
from s2r_sim import parameters
from s2r_sim.controller.gains import RATE
from s2r_sim.protocols.references import reference
from s2r_sim.settings import Settings
from s2r_spec.backend import Channel, Operator, Option, Parameter, read_test
from s2r_spec.errors import MissingPackageError
from s2r_spec.protocols import PROTOCOL, Protocol, named
from s2r_spec.trace import Trace

if TYPE_CHECKING:
    from s2r_a1.attendance import Attendance

_MODULES = ("numba", "pinocchio", "piqp")
_DISTRIBUTIONS = ("numba", "numpy", "pin", "piqp")
_CONTROLLERS = frozenset(
    {
        *("robot", "controller", "rollout.py", "settings.py"),
        *("plant/channels.py", "plant/noise.py", "plant/physics.py", "plant/recorder.py"),
        "protocols/references.py",
    }
)
"""A definition: packages and modules of the simulator that affect the robot's motion or its traces."""
_NOT_HASHED = frozenset({"twin", "attendance.py", "hands.py", "vendor.py"})
"""A definition: files and folders of this package that affect neither."""

PARAMETERS = tuple(p for p in parameters.PARAMETERS if p.name in ("vd", "vy", "wz"))
"""The simulator's parameters that a robot can follow; the operator sets slope, payload and pushes."""
AROUND = 7.5
"""A budget [s]: time of a rollout besides the test: standing up, 1.2 s of trotting in place, the ramp, and writing the
packets. Only plans read it."""
PLACING = 10.0
"""A budget [s]: time for a person to put the robot back to its start. Only plans read it."""


@dataclass(frozen=True)
class A1Backend:
    """Unitree's A1 under the simulator's own controller; with ``host=127.0.0.1`` its twin.

    The robot trots in place, and at t = 0 of the trace the velocity command steps from zero to the test's value. Making
    a backend opens nothing. :meth:`rollout` needs a guard that :meth:`attendance` has armed in the process with the
    terminal.
    """

    options: InitVar[str] = ""
    """Options after the colon of the name, as in ``host=192.168.123.10,velocity=onboard``."""
    duration: float = 1.5
    folder: str | None = None
    """Folder for raw recordings; see :meth:`keeping`."""
    begins: Callable[[], None] | None = field(default=None, compare=False, repr=False)
    """Function to call at t = 0 of a rollout; see :meth:`saying`."""
    parameters: tuple[Parameter, ...] = field(default=PARAMETERS, init=False, repr=False)
    deterministic: bool = field(default=False, init=False)
    reached: Options = field(default=Options(""), init=False)
    """How to reach the robot."""
    exclusive: ClassVar[bool] = True
    offered: ClassVar[tuple[Option, ...]] = OFFERED
    example: ClassVar[str] = EXAMPLE

    def __post_init__(self, options: str) -> None:
        """Check the options and the installed packages at once."""
        for module in _MODULES:
            if find_spec(module) is None:
                raise MissingPackageError("sim", module)
        if options or not self.reached.host:
            object.__setattr__(self, "reached", read_options(options))
            self.placing  # noqa: B018 - raises an error if it is not valid
        object.__setattr__(self, "duration", ceil(self.duration * RATE - 1e-9) / RATE)

    @property
    def name(self) -> str:
        """Name for ``load_backend``, with options."""
        return f"a1:{write_options(self.reached)}"

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Every channel of every trace: the channels of ``sim`` that a robot has, and three more."""
        return channels("as the robot estimates it" if self.reached.mocap is None else "by motion capture")

    @property
    def assumptions(self) -> tuple[str, ...]:
        """Assumptions of every statement about this robot."""
        velocity = (
            "vx of a1 is its own estimate"
            if self.reached.mocap is None
            else "vx of a1 is measured by motion capture, whose clock is aligned with the gyroscope in every rollout"
        )
        twin = f"a1 at {self.reached.host} is a twin, not a robot: a simulation behind the robot's wire"
        return (velocity, twin) if self.reached.is_twin else (velocity,)

    @property
    def cost(self) -> float:
        """Expected time of one rollout, including the robot's return to its start [s]."""
        return self.duration + AROUND + (PLACING if self.reached.operator == "tty" else 0.0)

    @property
    def model_hash(self) -> str:
        """Hex digest over controller, gains, wire protocol, this package's source and the robot's name."""
        measured = "onboard" if self.reached.mocap is None else f"mocap {self.placing!r}"
        return _digest(f"{measured} {self.reached.robot}".rstrip())

    @property
    def placing(self) -> Placing:
        """Pose, in base axes, of the rigid body that motion capture tracks."""
        return read_placing(self.reached.body, self.reached.heading)

    @property
    def robot(self) -> RobotAddress:
        """Address and settings for the guard."""
        return self.reached

    def with_duration(self, seconds: float) -> Self:
        """Return this backend with rollouts of this duration [s], rounded up to a whole control tick."""
        return self._with(duration=seconds)

    def keeping(self, folder: str) -> Self:
        """Return this backend with its raw recordings in a folder; no file is ever overwritten."""
        return self._with(folder=folder)

    def saying(self, begins: Callable[[], None]) -> Self:
        """Return this backend with rollouts that call ``begins`` at t = 0."""
        return self._with(begins=begins)

    def _with(self, **changes: float | str | Callable[[], None]) -> Self:
        return replace(self, options=write_options(self.reached), **changes)  # type: ignore[arg-type]

    def attendance(self, operator: Operator) -> Attendance:
        """Return the attendance of the rollouts, for the process with the terminal; open nothing."""
        from s2r_a1.attendance import Attendance

        return Attendance(self, operator)

    def prepare(self) -> None:
        """Compile the controller in this process, so that a rollout can begin at once."""
        from s2r_a1.rollout import pilot

        pilot()

    def rollout(self, params: Mapping[str, float], seed: int) -> Trace:
        """Run one test; samples every 2 ms from the command at t = 0 to ``duration`` inclusive.

        If the robot ended the test, ``meta["failure"]`` is the guard's word ("fall"); if anything else did,
        ``meta["void"]`` is. Both set ``meta["reason"]``.

        Raises:
            UsageError: a parameter is unknown or out of range.
            NotBegunError: the test did not begin; nothing happened at t = 0 or later.
        """
        test = read_test("a1", PARAMETERS, params)
        # Imported here, so that a list of backends loads no controller.
        from s2r_a1.rollout import run

        return run(self, test, seed)

    def protocols(self) -> tuple[Protocol, ...]:
        """Return the excitation protocols of `sim`, with gains within the guard's limits."""
        around = self.cost - self.duration
        return tuple(replace(protocol, cost=protocol.duration + around) for protocol in PROTOCOLS)

    def run(self, protocol: str, params: Mapping[str, float], seed: int) -> Trace:
        """Run a protocol; samples every 2 ms from its begin to its duration inclusive.

        The first run of a protocol at a gain plays a quarter and half of the amplitude before.
        The seed is only recorded.
        ``meta`` is that of :meth:`rollout`, with the name of the protocol.

        Raises:
            UsageError: there is no such protocol, or a parameter is unknown or out of range.
            NotBegunError: the protocol did not begin; nothing happened at t = 0 or later.
        """
        values = named(PROTOCOLS, protocol, "a1").values(params)
        from s2r_a1.protocol_run import run

        return run(self, protocol, values, seed)

    def playable(self, protocol: str, params: Mapping[str, float]) -> Trace:
        """Return the references of a protocol; see :class:`s2r_spec.protocols.HasPlayable`.

        Raises:
            UsageError: there is no such protocol, or a parameter is unknown or out of range.
        """
        values = named(PROTOCOLS, protocol, "a1").values(params)
        made = reference(protocol, **values)
        return Trace(
            np.arange(len(made.q)) / RATE,
            {"q": made.q, "dq": made.dq, "kp": made.kp, "kd": made.kd},
            {"q": "rad", "dq": "rad/s", "kp": "N*m/rad", "kd": "N*m*s/rad"},
            {PROTOCOL: protocol, "params": values},
        )

    @property
    def settings(self) -> Settings:
        """Settings of the controller."""
        return Settings()


@cache
def _digest(measured: str) -> str:
    """Hash the values in use and the source, because a changed formula changes traces like a changed gain."""
    import s2r_sim

    digest = hashlib.sha256(f"{Settings()!r} {measured}".encode())
    for distribution in _DISTRIBUTIONS:
        digest.update(f" {distribution} {version(distribution)}".encode())
    here, simulator = Path(__file__).parent, Path(s2r_sim.__file__).parent
    own = [path for path in sorted(here.rglob("*.py")) if path.relative_to(here).parts[0] not in _NOT_HASHED]
    theirs = [
        path
        for place in sorted(_CONTROLLERS)
        for path in sorted((simulator / place).rglob("*.py")) or [simulator / place]
    ]
    for path in (*own, *theirs):
        digest.update(path.read_bytes())
    return digest.hexdigest()
