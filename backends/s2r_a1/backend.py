"""The `a1` backend: Unitree's A1 itself, or its twin, behind the guard that keeps it safe."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import InitVar, dataclass, field, replace
from functools import cache
from importlib.metadata import version
from importlib.util import find_spec
from math import ceil
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, ClassVar, Self

from s2r_a1.channels import channels
from s2r_a1.guard.place import Robot
from s2r_a1.mocap import Placing, read_placing
from s2r_a1.options import EXAMPLE, OFFERED, Options, read_options, write_options
from s2r_sim import parameters
from s2r_sim.controller.gains import RATE
from s2r_sim.settings import Settings
from s2r_spec.backend import Channel, Operator, Option, Parameter, read_test
from s2r_spec.errors import MissingPackageError
from s2r_spec.trace import Trace

if TYPE_CHECKING:
    from s2r_a1.attendance import Attendance

_MODULES = ("numba", "pinocchio", "piqp")
_DISTRIBUTIONS = ("numba", "numpy", "pin", "piqp")
_CONTROLLERS = frozenset(
    {
        *("robot", "controller", "rollout.py", "settings.py"),
        *("plant/channels.py", "plant/noise.py", "plant/physics.py", "plant/recorder.py"),
    }
)
"""A definition: rooms and modules of the simulator that decide what the robot does, or what a trace says of it."""
_ONLOOKERS = frozenset({"twin", "attendance.py", "vendor.py"})
"""A definition: files and folders of this package that decide neither."""

PARAMETERS = tuple(p for p in parameters.PARAMETERS if p.name in ("vd", "vy", "wz"))
"""Of the simulator's parameters those that a robot can be asked for; slope, payload and pushes are the operator's."""
AROUND = 7.5
"""A budget [s]: what a rollout takes besides the test: standing, 1.2 s of trotting in place, ramp, and the packets'
way to the disk. Only plans read it."""
PLACING = 10.0
"""A budget [s]: what putting the robot back to its start takes, where a person does it. Only plans read it."""


@dataclass(frozen=True)
class A1Backend:
    """Unitree's A1, walking under the simulator's own controller; with ``host=127.0.0.1`` its twin.

    The velocity command steps from zero to the test's value at t = 0 of the trace, out of trotting in place. Making a
    backend opens nothing; :meth:`rollout` needs a guard that was armed by whoever holds the terminal, by
    :meth:`attendance`.
    """

    options: InitVar[str] = ""
    """After the colon of the name, as in ``host=192.168.123.10,velocity=onboard``."""
    duration: float = 1.5
    folder: str | None = None
    """Where raw recordings go; see :meth:`keeping`."""
    begins: Callable[[], None] | None = field(default=None, compare=False, repr=False)
    """Is called at t = 0 of a rollout; see :meth:`saying`."""
    parameters: tuple[Parameter, ...] = field(default=PARAMETERS, init=False, repr=False)
    deterministic: bool = field(default=False, init=False)
    reached: Options = field(default=Options(""), init=False)
    """How the robot is reached."""
    exclusive: ClassVar[bool] = True
    offered: ClassVar[tuple[Option, ...]] = OFFERED
    example: ClassVar[str] = EXAMPLE

    def __post_init__(self, options: str) -> None:
        """Say at once what is wrong with the options, and which package is missing."""
        for module in _MODULES:
            if find_spec(module) is None:
                raise MissingPackageError("sim", module)
        if options or not self.reached.host:
            object.__setattr__(self, "reached", read_options(options))
            self.placing  # noqa: B018 - says what is wrong with it
        object.__setattr__(self, "duration", ceil(self.duration * RATE - 1e-9) / RATE)

    @property
    def name(self) -> str:
        """What ``load_backend`` makes this backend from."""
        return f"a1:{write_options(self.reached)}"

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Every channel of every trace: those of ``sim`` that a robot has, and three of its own."""
        return channels("as the robot estimates it" if self.reached.mocap is None else "by motion capture")

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What every statement about this robot rests on, beside its rollouts."""
        velocity = (
            "vx of a1 is its own estimate"
            if self.reached.mocap is None
            else "vx of a1 is by motion capture, whose clock was set by the gyroscope in every rollout"
        )
        twin = f"a1 at {self.reached.host} is a twin, a simulation behind the robot's wire, and no robot"
        return (velocity, twin) if self.reached.is_twin else (velocity,)

    @property
    def cost(self) -> float:
        """Expected time of one rollout, with putting the robot back [s]."""
        return self.duration + AROUND + (PLACING if self.reached.operator == "tty" else 0.0)

    @property
    def model_hash(self) -> str:
        """Hex digest over controller, gains, wire and this package's source; not over the robot's address."""
        measured = "onboard" if self.reached.mocap is None else f"mocap {self.placing!r}"
        return _digest(measured)

    @property
    def placing(self) -> Placing:
        """How motion capture's body is mounted."""
        return read_placing(self.reached.body, self.reached.heading)

    @property
    def robot(self) -> Robot:
        """What the guard must know to reach the robot."""
        reached = self.reached
        return Robot(
            reached.host, reached.port, clock=reached.clock, local=reached.local, module=reached.module
        )

    def with_duration(self, seconds: float) -> Self:
        """Return the same backend with rollouts of this length, rounded up to a whole control tick."""
        return self._with(duration=seconds)

    def keeping(self, folder: str) -> Self:
        """Return the same backend, whose raw recordings go to this folder; none is ever overwritten."""
        return self._with(folder=folder)

    def saying(self, begins: Callable[[], None]) -> Self:
        """Return the same backend, whose rollouts call ``begins`` at t = 0."""
        return self._with(begins=begins)

    def _with(self, **changes: float | str | Callable[[], None]) -> Self:
        return replace(self, options=write_options(self.reached), **changes)  # type: ignore[arg-type]

    def attendance(self, operator: Operator) -> Attendance:
        """Return who attends to the rollouts in the process that holds the terminal; opens nothing."""
        from s2r_a1.attendance import Attendance

        return Attendance(self, operator)

    def prepare(self) -> None:
        """Compile the controller in this process, so that a rollout begins at once."""
        from s2r_a1.rollout import pilot

        pilot()

    def rollout(self, params: Mapping[str, float], seed: int) -> Trace:
        """Walk one test; samples every 2 ms from the command at t = 0 to ``duration`` inclusive.

        What the robot ended itself sets ``meta["failure"]`` to the guard's word ("fall"); what anything else ended
        sets ``meta["void"]``. Both set ``meta["reason"]``.

        Raises:
            UsageError: a parameter is unknown or out of range.
            NotBegunError: the test could not begin; nothing happened at t = 0 or later.
        """
        test = read_test("a1", PARAMETERS, params)
        # Imported here so that listing backends costs no controller.
        from s2r_a1.rollout import run

        return run(self, test, seed)

    @property
    def settings(self) -> Settings:
        """Of the controller."""
        return Settings()


@cache
def _digest(measured: str) -> str:
    """Hash the values in use, and the source: a change of a formula changes traces as much as a gain does."""
    import s2r_sim

    digest = hashlib.sha256(f"{Settings()!r} {measured}".encode())
    for distribution in _DISTRIBUTIONS:
        digest.update(f" {distribution} {version(distribution)}".encode())
    here, simulator = Path(__file__).parent, Path(s2r_sim.__file__).parent
    own = [path for path in sorted(here.rglob("*.py")) if path.relative_to(here).parts[0] not in _ONLOOKERS]
    theirs = [
        path for path in sorted(simulator.rglob("*.py")) if _within(path.relative_to(simulator), _CONTROLLERS)
    ]
    for path in (*own, *theirs):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def _within(path: PurePath, places: frozenset[str]) -> bool:
    """Return whether a path is one of these files, or lies in one of these folders."""
    return any(place.as_posix() in places for place in (path, *path.parents))
