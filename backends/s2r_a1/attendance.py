"""The dialogue around the rollouts of a robot, in the process with the terminal.

    begin     start the guard or attach to it; consent to connect, consent to arm
    before    the next test: place the robot, check the battery; a rest if it is due
    before_protocol   the same for a protocol: consent to its risk before its first run, then the rig or the floor
    after     report how the rollout ended, and the motors' temperature
    interrupt ramp down, stand, lie; urgent: damp
    end       lie, rest

With ``operator=auto``, for twins only, no question is asked: every answer is yes, and a message says so once.
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from contextlib import suppress
from math import ceil, isfinite
from typing import TYPE_CHECKING, Any

from s2r_a1 import hands
from s2r_a1.guard.control import Connection, ControlError, RefusedError
from s2r_a1.guard.start import start
from s2r_a1.mocap import DELAYED
from s2r_a1.protocols import height_in_rig
from s2r_a1.schedule import RAMP
from s2r_sim.controller.gains import RATE
from s2r_spec.backend import Coming, Operator
from s2r_spec.errors import BackendError, NotBegunError
from s2r_spec.protocols import Protocol
from s2r_spec.trace import Trace

if TYPE_CHECKING:
    from s2r_a1.backend import A1Backend

TESTS = 10
"""A budget: tests between two rests."""
WARM = 50.0
"""A level [°C]: with a motor at least this warm a rest is due, and the guard does not arm the robot."""
COOL = 45.0
"""A level [°C]: a rest for heat ends when all motors are below it. A higher level ends it sooner, and the next rest
comes sooner."""
LYING = 20.0
"""A budget [s]: time for lying down, in rounds of the guard, because a busy machine is slow in lock step."""
LOOK = 0.02
"""A budget [s]: interval between two requests for the state."""

LIGHTS = {lights: f"{lights} lights; begin" for lights in ("2", "3", "4")}
"""A definition: battery lights with which a test may begin; an A1 does not report its charge."""
MOVING = ("STANDING_UP", "STAND", "WALK", "EXCITE", "EXCITE_HELD")
WORD_CONNECT, WORD_ARM, WORD_PLAY = "connect", "arm", "play"
"""Definitions: what the operator types to consent to connecting, to arming, and to the first run of a protocol."""


class Attendance:
    """Attends to the rollouts of a robot (:class:`s2r_spec.backend.Attended`).

    Attributes:
        unattended: whether no questions are asked.
        answers: the operator's answers before the next test: ``battery_lights``, if the operator checked them.
    """

    def __init__(self, backend: A1Backend, operator: Operator) -> None:
        reached = backend.reached
        self.unattended = reached.operator == "auto"
        self._backend, self._operator = backend, operator
        self._name = "the twin" if reached.is_twin else f"the robot {reached.robot}"
        self._guard: Connection | None = None
        self.answers: dict[str, str] = {}
        self._lights_due = True
        self._tests = 0
        self._since_rest = 0
        self._rig: float | None = None
        self._consented: set[str] = set()

    def begin(self, coming: Coming) -> None:
        """Start the guard or attach to a running one, and ask for both consents.

        Raises:
            BackendError: the robot cannot be reached, or is not ready; the message says what to do.
            StoppedError: the operator ends the run.
        """
        reached = self._backend.reached
        where = f"{self._name} at {reached.host}:{reached.port}"
        if coming.rollouts != 0:
            self._operator.say(self._effort(coming.rollouts, where))
        if reached.is_twin:
            self._operator.say("It is a twin, not a robot: a simulation behind the robot's wire.")
        if self.unattended:
            self._operator.say("operator=auto: s2r connects, arms and walks it without questions.")
        guard, status = start(reached)
        # Two runs of one robot would alternate, and the end of one would make it lie down during the other's test.
        others = [pid for pid in status.get("operators", ()) if pid != os.getpid()]
        if others:
            guard.close()
            raise BackendError(
                f"another run uses {where} (process {others[0]}); wait until it ends, or end it with Ctrl-C"
            )
        self._guard = guard
        self._make_ready(consent=True)

    def _effort(self, rollouts: int | None, robot: str) -> str:
        """Return the time and the floor that this largest number of rollouts needs; None if it is unknown."""
        backend = self._backend
        fastest = max(abs(p.low) for p in backend.parameters if p.name == "vd")
        metres = fastest * (backend.duration + RAMP / RATE / 2.0)
        one = f"each takes about {backend.cost:.0f} s and at most {metres:.1f} m of floor"
        if rollouts is None:
            return f"An unknown number of rollouts of {robot} is coming: {one}."
        return (
            f"At most {rollouts} rollouts of {robot} are coming: {one}, so about "
            f"{ceil(rollouts * backend.cost / 60.0)} min and {rollouts * metres:.0f} m in all."
        )

    def before(self, params: Mapping[str, float]) -> None:
        """Return as soon as the robot is at its start and ready for a test, or raise what ``Attended`` states."""
        self._prepare(None)
        units = {parameter.name: parameter.unit for parameter in self._backend.parameters}
        test = ", ".join(
            f"{name} = {value:.6g} {units.get(name, '')}".rstrip() for name, value in params.items()
        )
        way = "behind it, because it walks backwards," if params.get("vd", 0.0) < 0.0 else "ahead"
        self._confirm(
            f"Test {self._tests + 1}: {test}. Lay {self._name} down at its start, with free floor {way} and 1 m "
            "around it"
        )

    def before_protocol(self, protocol: Protocol, params: Mapping[str, float]) -> None:
        """Return as soon as the robot is in its rig or on the floor, and ready for a run of a protocol.

        Besides what ``Attended`` states, StoppedError is raised if the operator does not accept the risk.
        """
        if protocol.name not in self._consented:
            risk = protocol.risk or "no more than in a test"
            self._consent(
                f"The protocol {protocol.name} is next. {protocol.words} Risk: {risk}. Its first run plays a quarter "
                "and half of its amplitude before. The guard's limits hold.",
                WORD_PLAY,
            )
            self._consented.add(protocol.name)
        rig = height_in_rig(protocol.name)
        self._prepare(rig)
        values = ", ".join(f"{name} = {value:.6g}" for name, value in params.items())
        where = (
            f"Lay {self._name} down on a flat floor, with 1 m around it"
            if rig is None
            else f"Hold {self._name} level in a rig, with its base {rig:g} m above the floor and its legs free"
        )
        with_values = f" with {values}" if values else ""
        self._confirm(f"Run {self._tests + 1}: the protocol {protocol.name}{with_values}. {where}")

    def _prepare(self, rig: float | None) -> None:
        """Make the robot ready, in a rig at a height [m] or on the floor (None); raise NotBegunError if it is not."""
        try:
            self._make_ready(consent=False)
            self._place(rig)
            self._rest_if_due()
        except BackendError as error:
            raise NotBegunError(str(error)) from None

    def _place(self, rig: float | None) -> None:
        """Have the robot lie down before it is put elsewhere; a twin has no hands around it, so s2r puts it there."""
        if rig == self._rig:
            return
        self._lay_down()
        reached = self._backend.reached
        if reached.is_twin:
            hands.put(reached.host, reached.port, rig)
            self._operator.say(
                "s2r put the twin onto its floor."
                if rig is None
                else f"s2r hung the twin into its rig, with its base {rig:g} m above the floor."
            )
        self._rig = rig

    def _confirm(self, words: str) -> None:
        """Ask whether the run may begin, with the lights of the battery."""
        lights = self._ask(
            f"{words}; keep the remote in your hand. How many lights does the battery show? Change it if it shows "
            "fewer than two.",
            LIGHTS if self._lights_due else {"": "begin without another look at the battery", **LIGHTS},
        )
        self.answers = {"battery_lights": lights} if lights else {}
        self._lights_due = False

    def after(self, trace: Trace | None) -> None:
        """Report how a rollout ended, what was late, and the temperature of the warmest motor."""
        if trace is None:
            return
        self._tests += 1
        self._since_rest += 1
        if self.unattended:
            return
        warmest = float(trace["motor_temperature"][-1].max())
        reason = str(trace.meta.get("reason", ""))
        if trace.failure:
            ended = f"ended by {self._name}, {trace.failure}: {reason}"
        elif "void" in trace.meta:
            ended = f"void, {trace.meta['void']}: {reason}"
        else:
            ended = f"complete, {trace.duration:g} s"
            if missed := trace.meta.get("late", 0):
                ended += f", {missed} of {missed + len(trace)} control ticks missed"
            delay = trace.meta.get("mocap", {}).get("delay", 0.0)
            if delay >= DELAYED:
                ended += f", motion capture {delay:.2f} s late"
        heat = f" The warmest motor is at {warmest:.0f} °C." if isfinite(warmest) else ""
        self._operator.say(f"Test {self._tests}: {ended}.{heat}")

    def interrupt(self, urgent: bool) -> None:
        """Bring the robot to rest, at once if ``urgent``; return without waiting."""
        if self._guard is None:
            return
        if urgent:
            self._request("damp", reason="the operator pressed Ctrl-C twice")
        else:
            self._request("lie")

    def end(self) -> None:
        """Bring the robot to rest; the guard ends by itself one minute later."""
        if self._guard is None:
            return
        try:
            self._lay_down()
            if self._backend.reached.is_twin:
                self._place(None)
        except ControlError:
            self._operator.say(f"The guard has ended: nothing holds {self._name} now; check it.")
        finally:
            self._guard.close()
            self._guard = None

    def _make_ready(self, consent: bool) -> None:
        """Bring the guard to a state in which a test can begin; ``consent`` asks again if an earlier run armed it."""
        try:
            status = self._request("status")
        except ControlError:
            assert self._guard is not None
            self._operator.say(f"The guard has ended, and s2r starts a new one. Check {self._name} first.")
            self._guard.close()
            self._guard, status = start(self._backend.reached)
        state = status["state"]
        if state == "DAMPING":
            self._ask(
                f"{_sentence_case(self._name)} was damped: {status.get('reason') or 'the reason is unknown'}. Check "
                "it, lay it down, and remove the cause.",
                {"r": "reset; it stays limp until you arm it"},
            )
            self._request("reset")
            state = self._state()
        if state == "OFF":
            self._consent(question_to_connect(self._name), WORD_CONNECT)
            self._request("connect")
            state = self._state()
        if state == "LINKED":
            self._consent(
                f"{_sentence_case(self._name)} answers. Lay it on the floor, with 1 m of room around it. Take "
                "the remote in your hand: R2 or L2+B damps it at once. Arming allows it to move.",
                WORD_ARM,
            )
            self._request("arm")
        elif consent:
            self._consent(
                f"{_sentence_case(self._name)} is still armed from an earlier run: it may move.", WORD_ARM
            )

    def _rest_if_due(self) -> None:
        """Ask for a rest after ``TESTS`` tests, or if a motor is warm."""
        warm = self._warmest() >= WARM
        if self.unattended or not (warm or self._since_rest >= TESTS):
            return
        why = f"a motor is at {self._warmest():.0f} °C" if warm else f"{self._since_rest} tests are done"
        while True:
            answer = self._ask(
                f"A rest is due: {why}. {_sentence_case(self._name)} is lying; let it cool, and change the "
                "battery if necessary.",
                {"": "the rest is over", "s": "skip the rest"},
            )
            if answer == "s" or not warm or self._warmest() < COOL:
                break
            why = f"a motor is still at {self._warmest():.0f} °C"
        self._since_rest = 0
        self._lights_due = True

    def _warmest(self) -> float:
        """Return the temperature of the warmest motor [°C]; 0 if unknown."""
        temperatures: list[float] = self._request("status").get("temperatures") or []
        return max(temperatures, default=0.0)

    def _request(self, do: str, **fields: str) -> dict[str, Any]:
        assert self._guard is not None
        return self._guard.request(do, **fields)

    def _state(self) -> str:
        return str(self._request("status")["state"])

    def _lay_down(self) -> None:
        """Wait until the robot lies or is damped; raise BackendError if this takes too long."""
        if self._state() in MOVING:
            with suppress(RefusedError):  # the guard has damped the robot since
                self._request("lie")
        status = self._request("status")
        last = status["rounds"] + round(LYING * RATE)
        while status["state"] in (*MOVING, "LYING_DOWN"):
            if status["rounds"] > last:
                raise BackendError(
                    f"{self._name} is still in the state {status['state']} after {LYING:g} s; damp it with: "
                    f"python -m s2r_a1.guard damp --host {self._backend.reached.host} "
                    f"--port {self._backend.reached.port}"
                )
            time.sleep(LOOK)
            status = self._request("status")

    def _consent(self, question: str, word: str) -> None:
        if not self.unattended:
            self._operator.type_word(question, word)

    def _ask(self, question: str, answers: Mapping[str, str]) -> Any:
        return None if self.unattended else self._operator.choose(question, answers)


def question_to_connect(robot: str) -> str:
    """Return the question before the first packet to a robot."""
    return (
        f"Let {robot} hang or lie, and end the factory's own controller with L2+B on the remote, so that "
        "its legs are limp. s2r has sent nothing yet; connecting sends packets without gains or torque."
    )


def _sentence_case(text: str) -> str:
    return text[0].upper() + text[1:]
