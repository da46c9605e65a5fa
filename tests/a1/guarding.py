"""A robot as its guard sees it, made by hand."""

import numpy as np

from s2r_a1.guard import moves, transitions
from s2r_a1.guard.limits import LIMITS, ROUND
from s2r_a1.guard.states import Inputs, Machine, State
from s2r_a1.guard.step import judge_arrival, step
from s2r_a1.guard.transitions import Conditions
from s2r_a1.remote import pack_buttons
from s2r_a1.wire import CLOSED_LOOP, Orders, Reading

ZERO = np.zeros(12)
LYING = np.tile([0.0, 1.3, -2.75], 4)  # calves beyond their limit, as they rest
READY = Conditions(unit=True, refusal=None, loopback=True)


def reading(q=LYING, tick=0, **fields):
    """Return the reading of a robot that is well, and at rest in a pose."""
    made = Reading(
        quaternion=np.array([1.0, 0.0, 0.0, 0.0]),
        gyro=np.zeros(3),
        accelerometer=np.array([0.0, 0.0, 9.81]),
        q=np.array(q, dtype=float),
        dq=np.zeros(12),
        tau=np.zeros(12),
        temperature=np.full(12, 30.0),
        mode=np.full(12, CLOSED_LOOP),
        tick=tick,
        remote=pack_buttons(),
    )
    return made._replace(**fields)


def at(values, joint, value):
    """Return twelve values with another one at a joint."""
    changed = np.array(values, dtype=float)
    changed[joint] = value
    return changed


def leaning(angle):
    """Return the attitude of a base that is rolled by an angle."""
    return np.array([np.cos(angle / 2), np.sin(angle / 2), 0.0, 0.0])


def walking(tau=0.0):
    """Return orders as a client's."""
    return Orders(moves.STANDING, ZERO, np.full(12, 20.0), np.full(12, 0.75), np.full(12, tau))


class Rounds:
    """A machine that is taken through rounds; the robot goes where its orders want it."""

    def __init__(self, machine=None, orders=None, q=LYING):
        self.machine = machine or Machine()
        self.orders = orders
        self.q = q

    @property
    def state(self):
        return self.machine.state

    def turn(self, count=1, orders=None, until=None, silent=False, bad=False, dropped=0, **fields):
        """Turn rounds, at most ``count``, until the machine is in a state; return how many."""
        for turned in range(count):
            if self.state is until:
                return turned
            now = self.machine.memory.now + ROUND
            if self.orders is not None and self.orders.kp.any():
                self.q = self.orders.q
            seen = None if silent or bad else reading(self.q, **fields)
            came = judge_arrival(LIMITS, seen, "number" if bad else None)
            done = step(self.machine, Inputs(now, came, orders, dropped), LIMITS)
            self.machine, self.orders = done
        return count

    def ask(self, do, role="client", reason=None):
        """Make a request; return the sentence of a refusal."""
        self.machine, refusal = transitions.request(self.machine, do, role, reason, LIMITS)
        return refusal

    def bring(self, state):
        """Bring the robot from OFF to a state by the operator's and the client's requests."""
        now = self.machine.memory.now
        self.machine = transitions.connect(self.machine, now)
        self.turn(300)
        if state is State.LINKED:
            return self
        assert transitions.unready(self.machine, READY, LIMITS) is None
        self.machine = transitions.arm(self.machine, self.machine.memory.now)
        self.turn()
        ways = {
            State.ARMED: (),
            State.STANDING_UP: ("stand",),
            State.STAND: ("stand", State.STAND),
            State.WALK: ("stand", State.STAND, "walk"),
            State.EXCITE: ("stand", State.STAND, "excite"),
            State.EXCITE_HELD: ("stand", State.STAND, "excite_held"),
            State.LYING_DOWN: ("stand", State.STAND, "lie"),
            State.RESTING: ("stand", State.STAND, "lie", State.RESTING),
            State.DAMPING: ("stand", "damp"),
        }
        for way in ways[state]:
            if isinstance(way, State):
                self.turn(2000, until=way)
                assert self.state is way
            else:
                assert self.ask(way) is None
                self.turn(orders=walking())
        assert self.state is state
        return self
