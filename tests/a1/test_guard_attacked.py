"""What must not move a guard: pauses, strange requests, too many of them, files that somebody takes away."""

import pytest

from s2r_a1.guard import states
from s2r_a1.guard.limits import LIMITS, MS
from s2r_a1.guard.states import Inputs, State
from tests.a1.guarding import Rounds, reading, walking

HOLDING = (State.STANDING_UP, State.STAND, State.WALK, State.LYING_DOWN)


@pytest.mark.parametrize("state", HOLDING)
@pytest.mark.parametrize(("pause", "ends"), [(18, False), (20, True), (5000, True)])
def test_a_guard_that_was_held_up_damps_a_robot_that_it_holds(state, pause, ends):
    robot = Rounds().bring(state)
    now = robot.machine.memory.now + pause * MS
    machine, _ = states.step(robot.machine, Inputs(now, reading(robot.q), False, walking()), LIMITS)
    assert (machine.state is State.DAMPING) is ends
    assert machine.word == ("link" if ends else None)
